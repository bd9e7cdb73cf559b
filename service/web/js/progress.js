// One job from the first uploaded byte to its end: a bar, the steps done so far, and a way out.
import { $, focusOn, h } from "./dom.js";
import { cancel, follow } from "./jobs.js";
import { Pace, leftWords, turnWords } from "./pace.js";
import { nameJob } from "./session.js";
import { upload } from "./upload.js";
import { bytes, stageWords } from "./words.js";

const LOST = "Connection lost. Reconnecting";
const WORTH_SAYING = 0.2; // seconds a step takes to be listed

/** Thrown when the user cancelled. */
export class Cancelled extends Error {}

export class Progress {
  #stop = new AbortController();
  #job = null;
  #cancelled = false;
  #begins = false;
  #began = 0;
  #stage = null;
  #pace = new Pace();

  constructor(place, title) {
    this.bar = h("progress", { max: "1", "aria-label": title });
    this.now = h("p", { class: "progress-now", role: "status", "aria-live": "polite" });
    this.side = h("span", { class: "progress-side", "aria-hidden": "true" });
    this.done = h("ol", { class: "progress-done" });
    this.button = h("button", { type: "button", class: "quiet", onclick: () => this.cancel() }, "Cancel");
    this.away = h("p", { class: "help", hidden: true }, "You can close this page; the job continues under ", h("a", { href: "#jobs" }, "Jobs"), ".");
    const heading = h("h2", { tabindex: "-1" }, title);
    place.replaceChildren(h("div", { class: "card progress" }, heading, this.done,
      h("div", { class: "progress-line" }, this.now, this.side), this.bar, this.away, this.button));
    focusOn(heading);
  }

  /** Upload files one after the other; their uploads. */
  async upload(files) {
    const total = files.reduce((sum, file) => sum + file.size, 0);
    const uploads = [];
    let before = 0;
    for (const file of files) {
      const tell = (sent, waiting, digesting = false) => {
        const words = digesting ? "Computing the digest" : waiting ? LOST : sent < file.size ? "Uploading" : "Reading the file";
        this.#show(words, words === "Reading the file" ? null : (before + sent) / total);
        this.side.textContent = `${bytes(before + sent)} of ${bytes(total)}`;
      };
      tell(0, false);
      uploads.push(await this.#stoppable(upload(file, tell, this.#stop.signal)));
      before += file.size;
    }
    return uploads;
  }

  /** Start a job with `begin(signal)`, called `name` in the list of jobs, and follow it to its end. */
  async run(begin, name) {
    this.#show("Queued", null);
    this.#begins = true;
    const job = await this.#stoppable(begin(this.#stop.signal));
    this.#job = job.id;
    nameJob(job.id, name);
    this.away.hidden = false;
    if (this.#cancelled) await this.#end();
    const ended = await this.#stoppable(follow(job.id, (now) => this.#tell(now), this.#stop.signal));
    if (ended.state === "cancelled") throw new Cancelled();
    this.#show("Done", 1);
    return ended;
  }

  /** Stop: an upload is dropped at once; a job is ended by the service, which says when it has. */
  async cancel() {
    this.button.disabled = true;
    this.now.textContent = "Stopping";
    this.#cancelled = true;
    if (this.#job) await this.#end();
    else if (!this.#begins) this.#stop.abort();
    // else the job is being made: it is ended once its name is known, or it would run unseen
  }

  async #end() {
    // 409: it had ended already, and its end is on the way here
    await cancel(this.#job).catch((problem) => problem.status === 409 || this.#stop.abort());
  }

  async #stoppable(promise) {
    try {
      return await promise;
    } catch (error) {
      throw error.name === "AbortError" ? new Cancelled() : error;
    }
  }

  #tell(job) {
    if (job.cancelling || this.#cancelled) {
      this.now.textContent = "Stopping";
      return;
    }
    const [words, part] = stageWords(job.state === "queued" ? "" : job.stage);
    this.#show(words, (job.fraction_total ?? job.fraction) || null);
    const turn = job.state === "queued" && job.position ? turnWords(job) : "";
    this.side.textContent = [turn, part, leftWords(this.#pace.left(job))].filter(Boolean).join(" · ");
  }

  // The words change only with the stage, so that a screen reader hears each once; the bar moves in between.
  #show(words, fraction) {
    if (words !== this.#stage) {
      const seconds = (performance.now() - this.#began) / 1000;
      if (this.#stage !== null && this.#stage !== LOST && seconds > WORTH_SAYING) {
        this.done.append(h("li", {}, this.#stage, h("span", {}, `${seconds.toFixed(1)} s`)));
      }
      this.#stage = words;
      this.#began = performance.now();
      this.now.textContent = words;
      this.side.textContent = "";
    }
    if (fraction === null) this.bar.removeAttribute("value");
    else this.bar.value = fraction;
  }
}
