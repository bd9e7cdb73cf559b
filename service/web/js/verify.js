// Check a suspect: the form, and the claim that is made of it.
import { getJson } from "./api.js";
import { claimView } from "./claim.js";
import { $, fill, h } from "./dom.js";
import { jobForm } from "./jobform.js";
import { pager, whenTyped } from "./pages.js";
import { showProblem } from "./problem.js";
import { may } from "./session.js";
import { assetName } from "./words.js";

const PICTURE = /\.(png|jpe?g|webp|avif|bmp|gif|tiff?)$/i;

/** Wire the view; `enter` is called when it is shown, `leave` when the API key is gone. */
export function startVerify() {
  const show = async (made, again) => claimView(await getJson(`/v1/claims/${made.claim_id}`), { again });
  const { form, problem, run, leave } = jobForm("check", { title: "Checking the suspect", show });
  const listAssets = assetChoice((error) => showProblem(problem, error));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    fill(problem);
    const files = [...$("#check-files").files];
    const pictures = files.every((file) => PICTURE.test(file.name));
    if (!pictures && files.length > 1) {
      showProblem(problem, { title: "More than one suspect", detail: "Choose one model, or only pictures of one scene." });
      return;
    }
    const chosen = { asset_id: $("#check-asset").value || null, false_claim_rate: Number($("#check-rate").value) };
    const body = (ids) => ({ ...chosen, ...(pictures ? { image_upload_ids: ids } : { upload_id: ids[0] }) });
    run(files, "/v1/verify", body, files.length > 1 ? `${files[0].name} and ${files.length - 1} more` : files[0].name);
  });
  return {
    enter: () => {
      $("#check-which").hidden = !may("read");
      if (!form.hidden && may("read")) listAssets();
    },
    leave: () => {
      leave();
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
