// The takedown pack of a claim: what to send to the platform that shows the copy.
import { download } from "./api.js";
import { fresh, h } from "./dom.js";
import { problemBox } from "./problem.js";

/** A form that asks for what only the owner knows; nothing of it is kept. Null where there is nothing to ask for. */
export function packForm(claim, { headline }) {
  if (claim.verdict === "not_marked" || headline === "Not recognized") return null;
  const [copiesId, helpId, originalId, noteId] = ["copies", "help", "original", "note"].map((name) => fresh(`pack-${name}`));
  const copies = h("textarea", { id: copiesId, rows: 2, "aria-describedby": helpId, placeholder: "https://…" });
  const original = h("input", { id: originalId, type: "url", placeholder: "https://…" });
  const note = h("textarea", { id: noteId, rows: 3, maxlength: 1000 });
  const button = h("button", {}, "Download the takedown pack");
  const problem = h("div");
  const send = async (event) => {
    event.preventDefault();
    button.disabled = true;
    problem.replaceChildren();
    const query = new URLSearchParams(copies.value.split(/\s+/).filter(Boolean).map((url) => ["copy_url", url]));
    if (original.value.trim()) query.set("original_url", original.value.trim());
    if (note.value.trim()) query.set("note", note.value.trim());
    const path = `/v1/claims/${claim.claim_id}/pack?${query}`;
    await download(path, `${claim.claim_id}-pack.zip`).catch((error) => problem.replaceChildren(problemBox(error)));
    button.disabled = false;
  };
  const optional = () => h("span", { class: "optional" }, "optional");
  return h("details", { class: "card more" },
    h("summary", {}, "Request a takedown from a platform"),
    h("form", { onsubmit: send },
      h("label", { for: copiesId }, "Address of the copy ", optional()), copies,
      h("p", { class: "help", id: helpId }, "One address per line. Your text goes into the pack and is not stored."),
      h("label", { for: originalId }, "Address where you published the original ", optional()), original,
      h("label", { for: noteId }, "Your statement ", optional()), note,
      problem, button));
}
