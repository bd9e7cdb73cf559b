// Whose file is this? Manifests of published models that a file looks like.
import { request } from "./api.js";
import { $, fill, h } from "./dom.js";
import { dropZone } from "./drop.js";
import { showProblem } from "./problem.js";

const LIKENESS = { 100: "clearly alike", 50: "close to the limit of recognition" };

/** Wire the form; returns what empties it. */
export function startWhose() {
  const [form, found, button] = [$("#whose-form"), $("#whose-found"), $("#whose-form button")];
  const clear = dropZone($("#whose-drop"), () => fill(found));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    button.disabled = true;
    fill(found, h("p", {}, "Searching…"));
    try {
      const [file] = $("#whose-file").files;
      const options = { method: "POST", body: file, headers: { "Content-Type": "application/octet-stream" } };
      const { matches } = await (await request("/v1/matches/byContent", options)).json();
      fill(found, matches.length ? h("ul", { class: "list" }, matches.map(match)) : h("p", {}, "No published model of this service looks like this file."));
    } catch (error) {
      showProblem(found, error);
    } finally {
      button.disabled = false;
    }
  });
  return clear;
}

const match = ({ manifestId, similarityScore }) =>
  h("li", {}, h("a", { href: `/v1/manifests/${encodeURIComponent(manifestId)}`, download: "manifest.c2pa" },
    h("strong", {}, manifestId), h("span", {}, `${LIKENESS[similarityScore] ?? similarityScore} · download the manifest`)));
