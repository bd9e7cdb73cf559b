// Check a suspect: the form, the job, the claim.
import { getJson, postOnce } from "./api.js";
import { claimView } from "./claim.js";
import { $, fill, focusOn, h, only } from "./dom.js";
import { dropZone } from "./drop.js";
import { refusal } from "./embed.js";
import { pager, whenTyped } from "./pages.js";
import { showProblem } from "./problem.js";
import { Cancelled, Progress } from "./progress.js";
import { may } from "./session.js";
import { assetName } from "./words.js";

const PICTURE = /\.(png|jpe?g|webp|avif|bmp|gif|tiff?)$/i;

/** Wire the view; `enter` is called when it is shown, `leave` when the API key is gone. */
export function startVerify() {
  const [form, intro, place, result, problem] =
    ["form", "intro", "progress", "result", "problem"].map((name) => $(`#check-${name}`));
  const clear = dropZone($("#check-drop"), () => fill(problem));
  const listAssets = assetChoice((error) => showProblem(problem, error));
  let progress = null;

  const again = () => {
    fill(result);
    fill(place);
    only(form, form, place, result);
    intro.hidden = false;
  };

  const run = async (files, pictures) => {
    const chosen = { asset_id: $("#check-asset").value || null, false_claim_rate: Number($("#check-rate").value) };
    only(place, form, place, result);
    const running = new Progress(place, "Checking the suspect");
    progress = running;
    try {
      const ids = (await running.upload(files)).map((uploaded) => uploaded.id);
      const body = { ...chosen, ...(pictures ? { image_upload_ids: ids } : { upload_id: ids[0] }) };
      const names = files.length > 1 ? `${files[0].name} and ${files.length - 1} more` : files[0].name;
      const job = await running.run((signal) => postOnce("/v1/verify", body, signal), names);
      if (running !== progress) return;
      if (job.state !== "succeeded") throw refusal(job);
      const view = claimView(await getJson(`/v1/claims/${job.result.claim_id}`), {
        again: () => { clear(); again(); focusOn($("#check-title")); },
      });
      intro.hidden = true;
      fill(result, view.element);
      only(result, form, place, result);
      focusOn(view.heading);
      view.opened();
    } catch (error) {
      if (running !== progress) return;
      again();
      if (error instanceof Cancelled) focusOn($("#check-title"));
      else showProblem(problem, error);
    }
  };

  form.addEventListener("submit", (event) => {
    event.preventDefault();
    fill(problem);
    const files = [...$("#check-files").files];
    const pictures = files.every((file) => PICTURE.test(file.name));
    if (!pictures && files.length > 1) {
      showProblem(problem, { title: "More than one suspect", detail: "Choose one model, or only pictures of one scene." });
      return;
    }
    run(files, pictures);
  });
  return {
    enter: () => {
      $("#check-which").hidden = !may("read");
      if (!form.hidden && may("read")) listAssets();
    },
    leave: () => {
      progress?.cancel();
      progress = null;
      again();
      fill($("#check-asset"), ALL());
      $("#check-search").value = "";
    },
  };
}

const ALL = () => h("option", { value: "" }, "All my marked models");

/** The models to choose from, the newest hundred and more on request; returns what lists them. What was chosen stays. */
function assetChoice(failed) {
  const [select, search] = [$("#check-asset"), $("#check-search")];
  const list = pager({
    path: "/v1/assets",
    params: () => ({ q: search.value.trim() }),
    clear: () => {
      const [chosen] = [...select.selectedOptions].filter((option) => option.value);
      fill(select, ALL(), chosen);
      select.value = chosen?.value ?? "";
    },
    add: (items, next) => {
      const listed = new Set([...select.options].map((option) => option.value));
      const fresh = items.filter((asset) => !listed.has(asset.id));
      select.append(...fresh.map((asset) => h("option", { value: asset.id }, assetName(asset))));
      if (next) $("#check-find").hidden = false;
    },
    more: $("#check-more"),
    failed,
    limit: 100,
  });
  whenTyped(search, list);
  return list;
}
