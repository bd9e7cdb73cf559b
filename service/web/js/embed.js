// Mark a model: the form, the job, the result.
import { getJson, postOnce } from "./api.js";
import { assetView } from "./asset.js";
import { $, fill, focusOn, only } from "./dom.js";
import { dropZone } from "./drop.js";
import { chosenKey, listKeys, startKeys } from "./keys.js";
import { showProblem } from "./problem.js";
import { Cancelled, Progress } from "./progress.js";
import { assetName } from "./words.js";

/** Wire the view; `enter` is called when it is shown, `leave` when the API key is gone. */
export function startEmbed() {
  const [form, intro, place, result, problem] =
    ["form", "intro", "progress", "result", "problem"].map((name) => $(`#mark-${name}`));
  const clear = dropZone($("#mark-drop"), () => fill(problem));
  let view = null;
  let progress = null;
  startKeys();

  const again = () => {
    view?.destroy();
    view = null;
    fill(result);
    fill(place);
    only(form, form, place, result);
    intro.hidden = false;
  };

  const run = async (key) => {
    const body = request(key);
    only(place, form, place, result);
    const running = new Progress(place, "Marking the model");
    progress = running;
    try {
      const [uploaded] = await running.upload([$("#mark-file").files[0]]);
      const begin = (signal) => postOnce("/v1/embed", { ...body, upload_id: uploaded.id }, signal);
      const job = await running.run(begin, assetName(body));
      if (running !== progress) return;
      if (job.state !== "succeeded") throw refusal(job);
      view = assetView(await getJson(`/v1/assets/${job.result.asset_id}`), {
        title: "Marked", made: job.result, again: () => { clear(); again(); focusOn($("#mark-title")); },
      });
      intro.hidden = true;
      fill(result, view.element);
      only(result, form, place, result);
      focusOn(view.heading);
      view.opened();
    } catch (error) {
      if (running !== progress) return;
      again();
      if (error instanceof Cancelled) focusOn($("#mark-title"));
      else showProblem(problem, error);
    }
  };

  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    fill(problem);
    const key = await chosenKey();
    if (key !== undefined) run(key);
  });
  return {
    enter: () => {
      if (form.hidden) return;
      listKeys().catch((error) => showProblem(problem, error));
    },
    leave: () => {
      progress?.cancel();
      progress = null;
      again();
      fill($("#mark-key"));
    },
  };
}

/** What the form asks for; what was left empty is left to the service. */
function request(key) {
  const value = (name) => $(`#mark-${name}`).value.trim();
  const number = (name) => (value(name) ? Number(value(name)) : null);
  const message = value("message").toLowerCase() || null;
  return {
    key_id: key || null,
    message,
    bits: message ? null : Number(value("bits")),
    profile: $("input[name=profile]:checked").value,
    psnr: number("psnr"),
    budget: number("budget"),
    format: value("format") || null,
    copy_name: value("copy"),
    label: value("label") || $("#mark-file").files[0].name.slice(0, 200),
  };
}

/** Why a job that ended gave no asset. */
export function refusal(job) {
  const { title, detail, request_id: requestId } = job.problem ?? { title: "The job failed" };
  return { title, detail, requestId, job: job.id };
}
