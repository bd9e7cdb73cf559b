// A claim: the verdict in words first, then how sure, then the evidence.
import { download, getBlob } from "./api.js";
import { fact, h } from "./dom.js";
import { problemBox } from "./problem.js";
import { VERDICTS, chance, raised, when } from "./words.js";
import { bits, scale } from "./charts.js";

const DISHONEST = Math.log10(2) * -128;

/** View of a signed claim: {element, heading}. */
export function claimView({ document: claim }, { again } = {}) {
  const [words, tone] = VERDICTS[claim.verdict];
  const heading = h("h1", { tabindex: "-1" }, words);
  const element = h("div", { class: "result" },
    h("div", { class: `verdict ${tone}` },
      h("div", { class: "result-head" }, heading,
        again ? h("button", { type: "button", class: "quiet", onclick: again }, "Check another") : null),
      h("p", {}, sentence(claim)),
      h("p", {}, raised(claim.meaning.says))),
    claim.threshold ? sureness(claim) : null,
    claim.message ? message(claim.message) : null,
    facts(claim),
    h("h2", {}, "What was checked"),
    h("ul", { class: "checks" }, claim.checks.map(check)),
    h("p", { class: "help" }, claim.meaning.does_not_say),
    files(claim));
  return { element, heading };
}

function sentence(claim) {
  const subject = claim.subject.kind === "pictures" ? "These pictures show" : "This model is";
  const copy = claim.copy ? `the copy made for ${claim.copy}` : "your registered model";
  if (claim.verdict === "marked") return `${subject} ${copy}, or something made from it.`;
  if (claim.verdict === "inconclusive") return claim.missing ? `Missing: ${claim.missing}.` : "The evidence is too weak for a yes or a no.";
  if (claim.derived_but_unmarked) {
    return `${claim.derived_fraction > 0.95 ? "Your model is" : "Parts of your model are"} in it, but not this copy’s mark.`;
  }
  return "Nothing of the mark that was looked for is there.";
}

function sureness(claim) {
  const threshold = Math.log10(claim.threshold.false_claim_rate);
  return h("section", { class: "sure" },
    h("h2", {}, "How sure"),
    claim.verdict === "marked"
      ? h("p", {}, "Chance of a false claim: at most ", h("strong", { class: "figure" }, chance(claim.log10_false_claim)),
        `, with ${claim.tries} ${claim.tries === 1 ? "try" : "tries"} counted.`)
      : h("p", {}, `A claim would need a chance of error of ${chance(threshold)} or less. `,
        claim.log10_false_claim < -1 ? `This evidence reaches ${chance(claim.log10_false_claim)}.` : "This evidence reaches none of it."),
    scale(claim.log10_false_claim, [
      [threshold, `needed: ${chance(threshold)}`],
      ...(DISHONEST < threshold - 1 ? [[DISHONEST, "against forgers: 1 in 2¹²⁸"]] : []),
    ]),
    h("p", { class: "help" }, raised(claim.meaning.record_time)));
}

function message(found) {
  return h("section", { class: "message" },
    h("h2", {}, "Message"),
    h("p", {}, h("strong", { class: "figure" }, `${found.matching} of ${found.bits}`), " bits match: ",
      h("code", {}, found.hex), found.hex === found.registered ? null : [", registered ", h("code", {}, found.registered)]),
    bits(found));
}

function facts(claim) {
  const share = claim.derived_fraction;
  return h("dl", { class: "facts" },
    claim.asset ? fact("Marked model", h("a", { href: `#asset/${claim.asset}` }, "Open it")) : null,
    claim.copy ? fact("Copy for", claim.copy) : null,
    claim.registered_at ? fact("Registered", when(claim.registered_at)) : null,
    share !== null ? fact("Of your model in it", `${(100 * share).toFixed(share < 0.1 ? 1 : 0)} %`) : null,
    claim.transform?.scale ? fact("Scaled by", claim.transform.scale.toFixed(3), h("small", {}, "suspect to yours")) : null,
    fact("Checked", when(claim.created_at)));
}

function check({ ok, text, code }) {
  const [sign, words] = ok === null ? ["?", "could not check"] : ok ? ["✓", "yes"] : ["✕", "no"];
  return h("li", { class: ok === null ? "open" : ok ? "yes" : "no", "data-code": code },
    h("span", { class: "sign", role: "img", "aria-label": words }, sign), h("span", {}, raised(text)));
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
      button("Download the signed claim", () => download(`${path}.jws`, `${claim.claim_id}.jws`))),
    h("p", { class: "help" }, "The signed claim can be checked offline: ",
      h("code", {}, `mark3dgs verify-report ${claim.claim_id}.jws --jwks jwks.json`)),
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
