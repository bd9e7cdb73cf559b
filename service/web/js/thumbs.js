// Small pictures of marked models, fetched once they come into view.
import { getBlob } from "./api.js";
import { h } from "./dom.js";

const coming = new IntersectionObserver((entries) => {
  for (const { isIntersecting, target } of entries) {
    if (!isIntersecting) continue;
    coming.unobserve(target);
    draw(target);
  }
}, { rootMargin: "200px" });

/** The marked one of a preview's three pictures (css/lists.css cuts it out); empty without an asset. */
export function thumbnail(assetId) {
  const box = h("span", { class: "thumb", "data-asset": assetId });
  if (assetId) coming.observe(box);
  return box;
}

async function draw(box) {
  try {
    const url = URL.createObjectURL(await getBlob(`/v1/assets/${encodeURIComponent(box.dataset.asset)}/preview.png`));
    const image = h("img", { src: url, alt: "" }); // the name stands next to it
    image.addEventListener("load", () => URL.revokeObjectURL(url), { once: true });
    box.replaceChildren(image);
  } catch {
    box.removeAttribute("data-asset"); // deleted since, or not for this API key: no picture is no fault of the list
  }
}
