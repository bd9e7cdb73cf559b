// The takedown pack of a claim: what to send to the platform that shows the copy.
import { download } from "./api.js";
import { h } from "./dom.js";
import { problemBox } from "./problem.js";

/** A form that asks for what only the owner knows; nothing of it is kept. Null where nothing was recognised. */
export function packForm(claim) {
  if (claim.verdict === "inconclusive" && !claim.derivation?.derived) return null;
  const copies = h("textarea", { id: "pack-copies", rows: 2, "aria-describedby": "pack-help", placeholder: "https://…" });
  const original = h("input", { id: "pack-original", type: "url", placeholder: "https://…" });
  const note = h("textarea", { id: "pack-note", rows: 3, maxlength: 1000 });
  const button = h("button", {}, "Download the takedown pack");
  const problem = h("div");
  const send = async (event) => {
    event.preventDefault();
    button.disabled = true;
    problem.replaceChildren();
    const told = new URLSearchParams(copies.value.split(/\s+/).filter(Boolean).map((url) => ["copy_url", url]));
    if (original.value.trim()) told.set("original_url", original.value.trim());
    if (note.value.trim()) told.set("note", note.value.trim());
    const path = `/v1/claims/${claim.claim_id}/pack?${told}`;
    await download(path, `${claim.claim_id}-pack.zip`).catch((error) => problem.replaceChildren(problemBox(error)));
    button.disabled = false;
  };
  const optional = () => h("span", { class: "optional" }, "optional");
  return h("details", { class: "card more" },
    h("summary", {}, "Ask a platform to take it down"),
    h("form", { onsubmit: send },
      h("label", { for: "pack-copies" }, "Where the copy is ", optional()), copies,
      h("p", { class: "help", id: "pack-help" }, "One address a line. What you write here goes into the pack and is kept nowhere."),
      h("label", { for: "pack-original" }, "Where you published it ", optional()), original,
      h("label", { for: "pack-note" }, "In your own words ", optional()), note,
      problem, button));
}
