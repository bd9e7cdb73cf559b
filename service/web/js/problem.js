// A problem as the user sees it.
import { focusOn, h } from "./dom.js";

/** A box that says what went wrong; announced at once. */
export function problemBox(problem) {
  return h("div", { class: "problem", role: "alert" },
    h("strong", {}, problem.title ?? "Something went wrong"),
    problem.detail && problem.detail !== problem.title ? h("p", {}, problem.detail) : null,
    reference(problem));
}

/** What to name when asking the operator about it. */
function reference({ requestId, job }) {
  if (!requestId && !job) return null;
  return h("p", { class: "note" }, requestId ? "Request " : "Job ", h("code", {}, requestId || job));
}

/** Show a problem in a place, and bring the reader to it. */
export function showProblem(place, error) {
  const box = problemBox(error.title ? error : { title: "Error in this page", detail: String(error.message ?? error) });
  place.replaceChildren(box);
  focusOn(box);
}
