// A marked model: numbers, files, the two models in 3D, the preview.
import { download, getBlob } from "./api.js";
import { copyable } from "./copy.js";
import { fact, h } from "./dom.js";
import { problemBox } from "./problem.js";
import { may } from "./session.js";
import { Viewer } from "./viewer.js";
import { count, fileStem, when } from "./words.js";

const FORMATS = ["ply", "compressed.ply", "splat", "spz", "sog", "glb", "usdz"];
const HEAVY = 1_500_000; // Gaussians; two of those are loaded on request only

/** View of an asset: {element, heading, opened(), destroy()}; of one just made, `made` is the result of its job. */
export function assetView(asset, { title, made = {}, again } = {}) {
  const name = asset.label || asset.id;
  const heading = h("h1", { tabindex: "-1" }, title ? `${title}: ${name}` : name);
  const viewer = may("originals") ? new Viewer(asset) : null; // it shows the original, too
  const preview = h("figure", { class: "preview" });
  const { report } = asset;
  const alone = pruned(report) ? " of the watermark alone" : "";
  const element = h("div", { class: "result" },
    h("div", { class: "result-head" }, heading,
      again ? h("button", { type: "button", class: "quiet", onclick: again }, "Mark another") : null),
    made.already_carries?.length ? h("p", { class: "hint" }, "It already carried one of your watermarks. Both can be read.") : null,
    made.not_screened ? h("p", { class: "hint" },
      `It resembles more registered copies than were checked: ${count(made.not_screened)} were not checked.`) : null,
    h("dl", { class: "facts" },
      fact("Fidelity", `${report.psnr_worst_view.toFixed(1)} dB`, h("small", {}, `PSNR${alone}, worst view`)),
      alone ? fact("In total", `${report.psnr_total_worst_view.toFixed(1)} dB`, h("small", {}, "PSNR with pruning, worst view")) : null,
      report.psnr_as_written === undefined ? null :
        fact("As written", `${report.psnr_as_written.toFixed(1)} dB`, h("small", {}, `PSNR of the .${asset.model_format} file`)),
      fact("Structure", report.ssim_worst_view.toFixed(4), h("small", {}, `SSIM${alone}, worst view`)),
      fact("Gaussians", count(asset.gaussians),
        h("small", {}, report.gaussians_in === asset.gaussians ? "all kept" : `of ${count(report.gaussians_in)}`)),
      fact("Message", h("code", {}, asset.message), h("small", {}, `${report.bits} bits`)),
      fact("Recipient", asset.copy_name || "none"),
      fact("Registered", when(asset.registered_at), h("small", {}, "attested by the log of this service"))),
    chosen(report.choice),
    files(asset),
    viewer ? [h("h2", {}, "Original and marked"), viewer.element] : null,
    h("h2", {}, "Preview"), preview,
    h("h2", {}, "IDs and digests"),
    h("dl", { class: "facts texts" },
      fact("asset", copyable(asset.id, "asset id")),
      fact("record", copyable(asset.record_id, "record id")),
      fact("owner key", copyable(asset.owner_key_id, "owner key id")),
      fact("SHA-256 of the original", copyable(asset.original_sha256, "SHA-256 of the original")),
      fact("SHA-256 of the marked model", copyable(asset.model_sha256, "SHA-256 of the marked model"))));
  return {
    element,
    heading,
    opened: () => {
      if (viewer) openViewer(viewer, asset);
      showPreview(preview, asset);
    },
    destroy: () => viewer?.destroy(),
  };
}

/** What Auto chose, and what that saved against Balanced; nothing of other profiles. */
function chosen(choice) {
  if (!choice) return null;
  const { views, psnr_db: db, wanted_z: wanted, predicted_z: predicted, saved_seconds: seconds, saved_bytes: bytes } = choice;
  const tried = wanted ? `a poor picture should show z ${predicted.toFixed(1)}, and ${wanted.toFixed(1)} is needed` : "no picture was tried";
  const said = [`Auto chose ${views} views and ${db.toFixed(0)} dB: ${tried}.`];
  if (bytes > 0) said.push(`The file is ${(bytes / 1e6).toFixed(1)} MB smaller than the whole model's.`);
  if (typeof seconds === "number")
    said.push(`This took about ${Math.abs(seconds).toFixed(1)} s ${seconds > 0 ? "less" : "more"} than Balanced would, by an estimate.`);
  return h("p", { class: "help" }, said.join(" "));
}

/** Whether the model differs from its original by more than the watermark. */
function pruned({ psnr_total_worst_view: total, psnr_worst_view: mark }) {
  return total < mark - 0.1;
}

function openViewer(viewer, asset) {
  if (asset.gaussians <= HEAVY) {
    viewer.load();
    return;
  }
  const button = h("button", { type: "button" }, `Open ${count(2 * asset.gaussians)} Gaussians in 3D`);
  button.addEventListener("click", () => {
    button.remove();
    viewer.load();
  });
  viewer.status.before(button);
}

function files(asset) {
  const format = h("select", { "aria-label": "Format of the marked model" },
    FORMATS.map((name) => h("option", { value: name }, name === asset.model_format ? `${name} (as made)` : name)));
  format.value = asset.model_format;
  const problem = h("div");
  const get = (button, path, name) => async () => {
    button.disabled = true;
    problem.replaceChildren();
    try {
      await download(path(), name());
    } catch (error) {
      problem.replaceChildren(problemBox(error));
    }
    button.disabled = false;
  };
  const model = h("button", { type: "button", class: "primary" }, "Download the marked model");
  const record = h("button", { type: "button" }, "Download the record");
  const stem = `${fileStem(asset)}-marked`;
  model.addEventListener("click", get(model, () => `/v1/assets/${asset.id}/model?format=${format.value}`, () => `${stem}.${format.value}`));
  record.addEventListener("click", get(record, () => `/v1/assets/${asset.id}/record`, () => `${stem}.record`));
  return h("div", { class: "files" }, h("div", { class: "row" }, format, model, may("originals") ? record : null),
    h("p", { class: "help" }, "Publish only the marked model. Keep the original private."), problem);
}

async function showPreview(figure, asset) {
  try {
    const url = URL.createObjectURL(await getBlob(`/v1/assets/${asset.id}/preview.png`));
    const image = h("img", { src: url, alt: "Renders of the original and of the marked model, and their difference times 20" });
    image.addEventListener("load", () => URL.revokeObjectURL(url), { once: true });
    figure.replaceChildren(image);
  } catch (error) {
    figure.replaceChildren(problemBox(error));
  }
}
