// A form that gives way to the progress of its job, and that to what came of it: of marking, and of checking.
import { postOnce } from "./api.js";
import { $, fill, focusOn, only } from "./dom.js";
import { dropZone } from "./drop.js";
import { showProblem } from "./problem.js";
import { Cancelled, Progress } from "./progress.js";

/**
 * Wire the drop zone of a form of this name; {form, problem, run, leave}.
 *
 * `title` is of its progress; `show(result, again)` makes the view of a job's result, with a button for `again`.
 * `run(files, path, body, called)` uploads files and starts the job with `body(uploads)`, which the list calls `called`.
 */
export function jobForm(name, { title, show }) {
  const [form, intro, heading, place, result, problem] =
    ["form", "intro", "title", "progress", "result", "problem"].map((part) => $(`#${name}-${part}`));
  const clear = dropZone($(`#${name}-drop`), () => fill(problem));
  let view = null;
  let progress = null;

  const reset = () => {
    view?.destroy?.();
    view = null;
    fill(result);
    fill(place);
    only(form, form, place, result);
    intro.hidden = false;
  };
  const again = () => {
    clear();
    reset();
    focusOn(heading);
  };

  const run = async (files, path, body, called) => {
    only(place, form, place, result);
    const running = new Progress(place, title);
    progress = running;
    try {
      const asked = body(await running.upload(files));
      const job = await running.run((signal) => postOnce(path, asked, signal), called);
      if (running !== progress) return;
      if (job.state !== "succeeded") throw refusal(job);
      view = await show(job.result, again);
      intro.hidden = true;
      fill(result, view.element);
      only(result, form, place, result);
      focusOn(view.heading);
      view.opened();
    } catch (error) {
      if (running !== progress) return;
      reset();
      if (error instanceof Cancelled) focusOn(heading);
      else showProblem(problem, error);
    }
  };

  const leave = () => {
    progress?.cancel();
    progress = null;
    reset();
  };
  return { form, problem, run, leave };
}

/** Why a job that ended gave nothing. */
function refusal(job) {
  const { title, detail, request_id: requestId } = job.problem ?? { title: "The job failed" };
  return { title, detail, requestId, job: job.id };
}
