// Mark a model: the form, and what is shown of the result.
import { getJson } from "./api.js";
import { assetView } from "./asset.js";
import { $, fill } from "./dom.js";
import { jobForm } from "./jobform.js";
import { chosenKey, dropKeys, listKeys, startKeys } from "./keys.js";
import { showProblem } from "./problem.js";
import { assetName } from "./words.js";

/** Wire the view; `enter` is called when it is shown, `leave` when the API key is gone. */
export function startEmbed() {
  const show = async (made, again) => assetView(await getJson(`/v1/assets/${made.asset_id}`), { title: "Marked", made, again });
  const { form, problem, run, leave } = jobForm("mark", { title: "Marking the model", show });
  startKeys();
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    fill(problem);
    const key = await chosenKey();
    if (key === undefined) return;
    const body = request(key);
    run([$("#mark-file").files[0]], "/v1/embed", ([{ id }]) => ({ ...body, upload_id: id }), assetName(body));
  });
  return {
    enter: () => {
      if (form.hidden) return;
      listKeys().catch((error) => showProblem(problem, error));
    },
    leave: () => {
      leave();
      dropKeys();
    },
  };
}

/** What the form asks for; what was left empty is left to the service. */
function request(key) {
  const value = (name) => $(`#mark-${name}`).value.trim();
  const number = (name) => (value(name) ? Number(value(name)) : null);
  const message = value("message").toLowerCase() || null;
  const profile = $("input[name=profile]:checked").value;
  return {
    key_id: key || null,
    message,
    bits: message ? null : Number(value("bits")),
    profile,
    survive: profile === "auto" ? value("survive") : null,
    psnr: number("psnr"),
    budget: number("budget"),
    format: value("format") || null,
    copy_name: value("copy"),
    label: value("label") || $("#mark-file").files[0].name.slice(0, 200),
  };
}
