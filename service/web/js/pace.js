// Time left of a job, from the progress that was seen; nothing where that would be a guess.

const WATCHED = 3; // seconds of one count before anything is said
const PASSED = 0.05; // of the whole, in that time

/** Watches one job. */
export class Pace {
  #count = null; // what is being counted: the job, or a step of it
  #from = null;
  #last = 0;

  /** {seconds, whole} left at the time `now`, seconds; whole: of the job, not of its step. Null where it cannot be said. */
  left(job, now = performance.now() / 1000) {
    const whole = typeof job.fraction_total === "number";
    const fraction = whole ? job.fraction_total : job.fraction;
    const count = job.state !== "running" ? null : whole ? "" : job.stage.replace(/^record .*/, "record");
    const anew = count === null || count !== this.#count || fraction < this.#last; // less: begun again
    this.#last = fraction;
    if (anew) {
      [this.#count, this.#from] = [count, { fraction, now }];
      return null;
    }
    const [took, passed] = [now - this.#from.now, fraction - this.#from.fraction];
    if (took < WATCHED || passed < PASSED || fraction >= 1) return null;
    return { seconds: ((1 - fraction) * took) / passed, whole };
  }
}

/** In words, coarse and rounded up; empty for null. */
export function leftWords(left) {
  if (left === null) return "";
  const { seconds, whole } = left;
  const time = seconds <= 10 ? "less than 10 s" : seconds <= 60 ? `about ${Math.ceil(seconds / 10) * 10} s` : `about ${Math.ceil(seconds / 60)} min`;
  return `${time} left${whole ? "" : " of this step"}`;
}

/** Where a waiting job stands in the queue. */
export function turnWords({ position }) {
  if (!position) return "Queued";
  return position === 1 ? "Queued: next" : `Queued: ${position - 1} before it`;
}
