// Check a suspect: the form, and the claim that is made of it.
import { Problem, getJson } from "./api.js";
import { claimView } from "./claim.js";
import { $, fill, h } from "./dom.js";
import { jobForm } from "./jobform.js";
import { getAll, pager, whenTyped } from "./pages.js";
import { showProblem } from "./problem.js";
import { has, may } from "./session.js";
import { startWhose } from "./whose.js";
import { assetName, suspectName } from "./words.js";

/** Wire the view; `enter` is called when it is shown, `leave` when the API key is gone; `add` takes more pictures into a
    check that has ended. */
export function startVerify() {
  const show = async (made, again) => claimView(await getJson(`/v1/claims/${made.claim_id}`), { again, add });
  const { form, problem, run, leave } = jobForm("check", { title: "Checking the suspect", show });
  const listAssets = assetChoice((error) => showProblem(problem, error));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    fill(problem);
    check([...$("#check-files").files], $("#check-asset").value || null);
  });
  const check = (files, asset, before = []) =>
    run(files, "/v1/verify", (uploads) => ({
      ...suspect(uploads, before), asset_id: asset, false_claim_rate: Number($("#check-rate").value),
    }), suspectName({ suspects: files.map((file) => file.name) }));
  const add = async (claim, files) => {
    const before = await stored(claim.subject.sha256);
    if (location.hash !== "#check") {
      location.hash = "#check";
      await new Promise((turned) => window.addEventListener("hashchange", turned, { once: true }));
    }
    await check(files, claim.searched?.scope === "one" ? claim.asset : null, before);
  };
  const leaveWhose = startWhose();
  return {
    add,
    enter: () => {
      $("#whose").hidden = !has("credentials");
      $("#check-which").hidden = !may("read");
      if (!form.hidden && may("read")) listAssets();
    },
    leave: () => {
      leave();
      fill($("#check-asset"), ALL());
      $("#check-search").value = "";
      leaveWhose();
    },
  };
}

/** What a request says of files that were brought, by what they hold and not by their names: one model, or pictures. */
function suspect(uploads, before) {
  const pictures = uploads.every(({ info }) => info?.kind === "picture");
  if (!pictures && before.length + uploads.length > 1) {
    const other = uploads.find(({ info }) => info?.kind !== "picture");
    throw new Problem({ title: "More than one suspect", detail: `Choose one model, or only pictures of one scene: ${other.name} is no picture.` });
  }
  return pictures ? { image_upload_ids: [...before, ...uploads.map(({ id }) => id)] } : { upload_id: uploads[0].id };
}

/** Uploads with these digests, in their order. */
async function stored(digests) {
  const ids = new Map((await getAll("/v1/uploads")).map(({ sha256, id }) => [sha256, id]));
  if (digests.every((one) => ids.has(one))) return digests.map((one) => ids.get(one));
  throw new Problem({ title: "The pictures of this check are gone", detail: "The service keeps uploads for a time only. Choose these pictures again, together with the others, under Check." });
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
