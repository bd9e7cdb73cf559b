// What was marked, and what was claimed: searched, paged, with small pictures.
import { $, fill, h } from "./dom.js";
import { pager, whenTyped } from "./pages.js";
import { showProblem } from "./problem.js";
import { thumbnail } from "./thumbs.js";
import { TONES, claimNames, count, when } from "./words.js";

/** Wire the view; `enter` fills both lists anew. */
export function startLibrary() {
  const search = $("#library-search");
  const verdict = $("#claims-verdict");
  const text = () => search.value.trim();
  const assets = entries("assets", assetLine, () => ({ q: text() }));
  const claims = entries("claims", claimLine, () => ({ q: text(), verdict: verdict.value }));
  const enter = () => {
    fill($("#library-problem"));
    assets();
    claims();
  };
  whenTyped(search, enter);
  verdict.addEventListener("change", claims);
  return {
    enter,
    leave: () => {
      search.value = verdict.value = "";
      for (const name of ["assets", "claims"]) fill($(`#${name}`));
    },
  };
}

const NONE = { assets: ["No marked models yet.", "#mark", "Mark a model"], claims: ["No checks yet.", "#check", "Check a suspect"] };

/** One of the two lists; returns what fills it. */
function entries(name, line, params) {
  const list = $(`#${name}`);
  const none = () => {
    if (Object.values(params()).some(Boolean)) return h("li", { class: "none" }, "No results.");
    const [said, way, words] = NONE[name];
    return h("li", { class: "none" }, h("p", {}, said, " ", h("a", { href: way }, words)));
  };
  return pager({
    path: `/v1/${name}`,
    params,
    clear: () => fill(list),
    add: (items) => {
      const made = items.map(line);
      list.append(...made);
      if (!list.children.length) list.append(none());
      return made;
    },
    more: $(`#${name}-more`),
    failed: (error) => showProblem($("#library-problem"), error),
  });
}

const assetLine = (asset) =>
  h("li", {}, h("a", { class: "pictured", href: `#asset/${asset.id}` }, thumbnail(asset.id),
    h("strong", { title: asset.label }, asset.label || asset.id),
    asset.copy_name ? h("span", { class: "clip", title: asset.copy_name }, `copy for ${asset.copy_name}`) : null,
    h("span", {}, `${count(asset.gaussians)} Gaussians · ${when(asset.registered_at)}`)));

function claimLine(claim) {
  const names = claimNames(claim);
  return h("li", {}, h("a", { class: "pictured", href: `#claim/${claim.id}` }, thumbnail(claim.asset_id),
    h("strong", {}, h("span", { class: `dot ${TONES[claim.verdict] ?? "plain"}`, "aria-hidden": "true" }), claim.headline),
    h("span", { class: "clip", title: names || claim.finding }, names || claim.finding),
    h("span", {}, when(claim.created_at))));
}
