// What was marked, and what was claimed.
import { getJson } from "./api.js";
import { $, fill, h } from "./dom.js";
import { showProblem } from "./problem.js";
import { TONES, count, when } from "./words.js";

/** Fill both lists anew. */
export function showLibrary() {
  fill($("#library-problem"));
  fillList("assets", assetLine, "Nothing is marked yet.");
  fillList("claims", claimLine, "Nothing was checked yet.");
}

async function fillList(name, line, none) {
  const list = $(`#${name}`);
  const more = $(`#${name}-more`);
  const load = async (after) => {
    try {
      const { items, next } = await getJson(`/v1/${name}?limit=20${after ? `&after=${encodeURIComponent(after)}` : ""}`);
      if (!after) fill(list);
      list.append(...items.map(line));
      if (!list.children.length) list.append(h("li", { class: "none" }, none));
      more.hidden = !next;
      more.onclick = () => load(next);
    } catch (error) {
      showProblem($("#library-problem"), error);
    }
  };
  await load("");
}

const assetLine = (asset) =>
  h("li", {}, h("a", { href: `#asset/${asset.id}` },
    h("strong", {}, asset.label || asset.id),
    h("span", {}, [asset.copy_name && `copy for ${asset.copy_name}`, `${count(asset.gaussians)} Gaussians`, when(asset.registered_at)]
      .filter(Boolean).join(" · "))));

const claimLine = (claim) =>
  h("li", {}, h("a", { href: `#claim/${claim.id}` },
    h("strong", {}, h("span", { class: `dot ${TONES[claim.verdict] ?? "plain"}`, "aria-hidden": "true" }), claim.headline),
    h("span", {}, `${claim.finding} · ${when(claim.created_at)}`)));
