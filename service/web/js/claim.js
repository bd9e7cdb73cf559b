// A claim: the verdict in words first, then how sure, then the evidence.
import { download, getBlob } from "./api.js";
import { copyable } from "./copy.js";
import { fact, h } from "./dom.js";
import { dropZone } from "./drop.js";
import { packForm } from "./pack.js";
import { claimPictures } from "./pictures.js";
import { problemBox } from "./problem.js";
import { has, may } from "./session.js";
import { shareForm } from "./share.js";
import { TONES, when } from "./words.js";
import { bits, scale } from "./charts.js";

const DRAWN = new Set(["false claim", "message read"]);

/** View of a signed claim: {element, heading, opened()}. `add(claim, files)` checks its pictures again, with more. */
export function claimView({ document: claim, summary }, { again, add } = {}) {
  const heading = h("h1", { tabindex: "-1" }, summary.headline);
  const link = h("a", { href: `#asset/${claim.asset}` }, "Open it");
  const pictures = claimPictures(claim, link);
  const share = has("shares") && may("verify") ? shareForm(claim) : null;
  const verdict = h("div", { class: `verdict ${TONES[claim.verdict]}` },
      h("div", { class: "result-head" }, heading,
        again ? h("button", { type: "button", class: "quiet", onclick: again }, "Check another") : null),
      h("p", {}, summary.finding),
      h("p", {}, claim.meaning.says));
  const element = h("div", { class: "result" },
    pictures.element ? h("div", { class: "evidence" }, verdict, pictures.element) : verdict,
    add && may("verify") && claim.verdict === "inconclusive" && claim.subject.kind === "pictures" ? morePictures(claim, add) : null,
    claim.threshold ? section("sure", "False-claim probability", summary, "false claim", (said) => scale(claim.log10_false_claim, summary.limits, said)) : null,
    h("p", { class: "help" }, claim.meaning.record_time),
    claim.message ? section("message", "Message read", summary, "message read",
      (said) => summary.reading.bits && bits(summary.reading, said)) : null,
    h("dl", { class: "facts texts" },
      pictures.examined,
      claim.asset ? fact("marked model", link) : null,
      summary.facts.filter(({ label }) => !DRAWN.has(label)).map(({ label, text }) => fact(label, text)),
      fact("checked", when(claim.created_at)),
      fact("claim", copyable(claim.claim_id, "claim id")), digests(claim.subject.sha256)),
    h("h2", {}, "Checks"),
    h("ul", { class: "checks" }, summary.checks.map(check)),
    h("p", { class: "help" }, claim.meaning.does_not_say),
    files(claim), has("packs") ? packForm(claim, summary) : null, share?.element);
  const opened = () => {
    pictures.opened();
    share?.opened();
  };
  return { element, heading, opened };
}

/** Pictures to be read together with those of a claim that was short of evidence. */
function morePictures(claim, add) {
  const problem = h("div");
  const input = h("input", { type: "file", multiple: true, required: true, accept: "image/*", "aria-label": "Further pictures" });
  const zone = h("div", { class: "drop" }, input, h("p", { class: "drop-name" }, "Drop further pictures of the same copy here, or choose files"));
  const button = h("button", {}, "Check all pictures together");
  const send = async (event) => {
    event.preventDefault();
    button.disabled = true;
    await add(claim, [...input.files]).catch((error) => problem.replaceChildren(problemBox(error)));
    button.disabled = false;
  };
  const many = claim.subject.sha256.length;
  const form = h("form", { class: "card narrow", onsubmit: send }, h("h2", {}, "Add pictures"),
    h("p", { class: "help" }, `They are read together with the ${many === 1 ? "picture" : `${many} pictures`} of this check. Other views of the same copy add evidence; the same picture again does not.`),
    zone, problem, button);
  dropZone(zone, () => problem.replaceChildren());
  return form;
}

/** Digests of what was examined; of many pictures those behind the first are folded away. */
function digests([first, ...others]) {
  const one = (sha256, k) => h("p", {}, copyable(sha256, others.length ? `SHA-256 of file ${k + 1}` : "SHA-256 of the suspect"));
  return fact("SHA-256 of the suspect", one(first, 0),
    others.length ? h("details", {}, h("summary", {}, `and ${others.length} more`), others.map((sha256, k) => one(sha256, k + 1))) : null);
}

/** A fact with its drawing. */
function section(kind, title, { facts }, label, draw) {
  const { text } = facts.find((found) => found.label === label);
  return h("section", { class: kind }, h("h2", {}, title), h("p", {}, text), draw(text));
}

function check({ ok, text, code, outcome }) {
  const [sign, kind] = ok === null ? ["?", "open"] : ok ? ["✓", "yes"] : ["✕", "no"];
  return h("li", { class: kind, "data-code": code },
    h("span", { class: "sign", role: "img", "aria-label": outcome }, sign), h("span", {}, text));
}

function files(claim) {
  const problem = h("div");
  const button = (text, act, kind = "") => {
    const element = h("button", { type: "button", class: kind }, text);
    element.addEventListener("click", async () => {
      element.disabled = true;
      problem.replaceChildren();
      await act().catch((error) => problem.replaceChildren(problemBox(error)));
      element.disabled = false;
    });
    return element;
  };
  const path = `/v1/claims/${claim.claim_id}`;
  return h("div", { class: "files" },
    h("div", { class: "row" },
      button("Open the full report", () => open(`${path}/report`), "primary"),
      button("Download the report", () => download(`${path}/report`, `${claim.claim_id}.html`)),
      button("Open the error rates", () => open(`${path}/annex`)),
      button("Download the signed claim", () => download(`${path}.jws`, `${claim.claim_id}.jws`))),
    h("p", { class: "help" }, "The signed claim can be checked offline, with the ",
      h("a", { href: "/.well-known/jwks.json", download: "jwks.json" }, "public signing keys"), ": ",
      copyable(`mark3dgs verify-report ${claim.claim_id}.jws --jwks jwks.json`, "the command", true)),
    problem);
}

async function open(path) {
  const tab = window.open("", "_blank"); // at once, while the click counts as the user's
  try {
    const url = URL.createObjectURL(await getBlob(path));
    if (tab) tab.location = url;
    else window.location = url;
  } catch (error) {
    tab?.close();
    throw error;
  }
}
