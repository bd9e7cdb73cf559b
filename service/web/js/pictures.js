// Pictures of a claim's suspect and asset, with their names: the report holds them, so they come out of it.
import { getJson, request } from "./api.js";
import { fact, h } from "./dom.js";
import { listPath } from "./pages.js";
import { assetName, suspectName } from "./words.js";

const NAMES = { suspect: "Suspect", asset: "Your model, marked", reference: "Your original" };

/** What a claim has pictures of: {element, examined, opened()}; element is null where there are none, and what was
    examined is named by itself then. `link` leads to the asset. */
export function claimPictures(claim, link) {
  const shown = Object.keys(NAMES).filter((name) => name in claim.pictures);
  const frames = Object.fromEntries(shown.map((name) => [name, h("div", { class: "frame" })]));
  const names = Object.fromEntries(shown.map((name) => [name, h("span", { class: "clip" })]));
  const element = shown.length ? h("div", { class: "side-by-side" }, shown.map((name) =>
    h("figure", {}, frames[name], h("figcaption", {}, NAMES[name], names[name])))) : null;
  const examined = fact("examined", names.suspect ? "" : (names.suspect = h("span")));
  examined.hidden = true;
  const opened = () => Promise.allSettled([draw(claim, frames), nameSuspect(claim, names, examined), nameAsset(claim, link, names)]);
  return { element, examined, opened };
}

async function draw(claim, frames) {
  if (!Object.keys(frames).length) return;
  const page = await (await request(`/v1/claims/${claim.claim_id}/report`)).text();
  const report = new DOMParser().parseFromString(page, "text/html"); // runs and loads nothing
  for (const [name, frame] of Object.entries(frames)) {
    const source = report.querySelector(`img[data-name="${name}"]`)?.getAttribute("src") ?? "";
    if (!source.startsWith("data:image/png;base64,")) continue;
    frame.replaceChildren(h("img", { src: source, alt: `${NAMES[name]}, as it was compared` }));
  }
}

/** File names are in lists of claims alone: they are not signed. */
async function nameSuspect(claim, { suspect }, examined) {
  const { items } = await getJson(listPath("/v1/claims", { q: claim.claim_id, limit: 1 }));
  if (items[0]?.id === claim.claim_id) suspect.textContent = suspect.title = suspectName(items[0]);
  examined.hidden = !examined.contains(suspect) || !suspect.textContent;
}

/** Put the asset's name in place of the link's words; a deleted one is no link any more. */
async function nameAsset(claim, link, names) {
  if (!claim.asset) return;
  try {
    const name = assetName(await getJson(`/v1/assets/${claim.asset}`));
    link.textContent = name;
    const caption = names.asset ?? names.reference;
    if (caption) caption.textContent = caption.title = name;
  } catch (error) {
    if (error.status === 404) link.replaceWith("deleted since");
  }
}
