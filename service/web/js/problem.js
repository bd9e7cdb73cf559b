// A problem as the user sees it.
import { focusOn, h } from "./dom.js";

/** A box that says what went wrong; announced at once. */
export function problemBox(problem) {
  return h("div", { class: "problem", role: "alert" },
    h("strong", {}, problem.title ?? "Something went wrong"),
    problem.detail && problem.detail !== problem.title ? h("p", {}, problem.detail) : null,
    problem.requestId ? h("p", { class: "note" }, "Request ", h("code", {}, problem.requestId)) : null);
}

/** Show a problem in a place, and bring the reader to it. */
export function showProblem(place, error) {
  const box = problemBox(error.title ? error : { title: "A fault of this page", detail: String(error.message ?? error) });
  place.replaceChildren(box);
  focusOn(box);
}
