// One job as a line of a list: open, with its progress; or ended, with its result.
import { copyable } from "./copy.js";
import { fill, h } from "./dom.js";
import { Pace, leftWords, turnWords } from "./pace.js";
import { TONES, assetName, claimNames, stageWords, took, when } from "./words.js";

const KINDS = { embed: "Mark", verify: "Check", dispute: "Dispute" };
const ENDS = { succeeded: "Done", disputed: "Not marked: it carries another owner's watermark", failed: "Failed", cancelled: "Cancelled" };
const DOTS = { succeeded: "good", disputed: "open", failed: "bad", cancelled: "plain" };

/** What a job is called. */
export const jobTitle = (job, name) => [KINDS[job.kind] ?? job.kind, name].filter(Boolean).join(" · ");

/** A job that waits or runs: {element, update(job)}; `stop(id)` when its button is pressed, false if it could not. */
export function openRow(job, name, stop) {
  const pace = new Pace();
  const title = jobTitle(job, name);
  const [now, side] = [h("span", { class: "progress-now" }), h("span", { class: "progress-side" })];
  const bar = h("progress", { max: "1", "aria-label": `Progress: ${title}` });
  const button = h("button", { type: "button", class: "quiet" }, "Cancel", h("span", { class: "unseen" }, ` ${title}`));
  button.addEventListener("click", async () => {
    if (button.getAttribute("aria-disabled")) return; // not disabled: that would take the focus away
    button.setAttribute("aria-disabled", "true");
    now.textContent = "Stopping";
    if (!(await stop(job.id))) button.removeAttribute("aria-disabled");
  });
  const update = (at) => {
    const left = leftWords(pace.left(at));
    const [words, part] = at.state === "queued" ? [turnWords(at), `since ${when(at.created_at)}`] : stageWords(at.stage);
    if (at.cancelling) button.setAttribute("aria-disabled", "true");
    now.textContent = button.getAttribute("aria-disabled") ? "Stopping" : words;
    side.textContent = [part, left].filter(Boolean).join(" · ");
    const fraction = at.fraction_total ?? at.fraction;
    bar.hidden = at.state === "queued";
    if (fraction) bar.value = fraction;
    else bar.removeAttribute("value");
  };
  const element = h("li", { class: "job", "data-job": job.id },
    h("div", { class: "job-head" }, h("strong", { class: "clip", title }, title), button), h("div", { class: "progress-line" }, now, side), bar);
  return { element, update };
}

/** A job that has ended: {element, title, result, wants, tell(item)}; `wants`: the kind, if its asset or claim has more to tell. */
export function endedRow(job, name) {
  const { state, kind, result } = job;
  const seconds = (new Date(job.finished_at) - new Date(job.started_at)) / 1000;
  const times = [when(job.finished_at), job.started_at && `took ${took(seconds)}`].filter(Boolean).join(" · ");
  const way = result?.claim_id ? `#claim/${result.claim_id}` : result?.asset_id ? `#asset/${result.asset_id}` : "";
  const dot = h("span", { class: `dot ${result?.verdict ? TONES[result.verdict] : DOTS[state]}`, "aria-hidden": "true" });
  const title = h("strong", {}, dot, jobTitle(job, name));
  const end = h("span", {}, endWords(job));
  const inside = [title, end, h("span", {}, times)];
  const element = h("li", { "data-job": job.id },
    way ? h("a", { href: way }, inside) : h("div", { class: "line" }, inside, h("span", {}, copyable(job.id, "job id"))));
  const tell = (found) => {
    if (!found) return;
    const item = found.summary ?? found; // of a claim by itself
    if (kind === "embed") fill(title, dot, jobTitle(job, assetName(item)));
    else {
      fill(title, dot, jobTitle(job, name || claimNames(item)));
      end.textContent = item.headline;
    }
  };
  return { element, title: title.textContent, result, wants: way && (kind === "verify" || !name) && kind, tell };
}

function endWords({ state, kind, problem, result }) {
  if (state === "failed" && problem) return problem.detail ? `${problem.title}: ${problem.detail}` : problem.title;
  if (state === "succeeded" && kind === "dispute") return `Settled. First: ${result.first}`;
  return ENDS[state] ?? state;
}
