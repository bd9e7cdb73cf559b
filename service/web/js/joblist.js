// The view of jobs: what waits and runs, with its place, progress and a way out; and what has ended.
import { getJson, pause } from "./api.js";
import { $, fill, focusOn, say } from "./dom.js";
import { ENDED, cancel } from "./jobs.js";
import { endedRow, openRow } from "./jobrow.js";
import { listPath, pager } from "./pages.js";
import { showProblem } from "./problem.js";
import { jobName } from "./session.js";
import { assetName } from "./words.js";

const OPEN = ["running", "queued"];
const BUSY = 1500; // milliseconds between two looks while something is open
const IDLE = 8000;

// This tab knows more of the jobs it started.
const named = (job) => jobName(job.id) || (job.copy_name ? assetName({ ...job, label: job.name }) : job.name);

/** Wire the view; `enter` shows it and keeps it up to date until `leave`. */
export function startJobs() {
  const [waiting, ended, problem] = ["open", "ended", "problem"].map((name) => $(`#jobs-${name}`));
  const rows = new Map(); // of open jobs, by id
  const done = new Set(); // ids of ended jobs that are listed
  let watch = new AbortController();

  const failed = (error) => showProblem(problem, error);
  const list = (jobs, put) => {
    const made = jobs.filter((job) => ENDED.has(job.state) && !done.has(job.id)).map((job) => endedRow(job, named(job)));
    for (const { element } of made) done.add(element.dataset.job);
    put(...made.map(({ element }) => element));
    $("#jobs-none").hidden = ended.children.length > 0;
    tellMore(made).catch(() => {}); // without it, the rows still say what ended and when
    return made;
  };
  const older = pager({
    path: "/v1/jobs",
    params: () => ({ state: [...ENDED] }),
    clear: () => {
      done.clear();
      fill(ended);
    },
    add: (jobs) => list(jobs, (...made) => ended.append(...made)).map(({ element }) => element),
    more: $("#jobs-more"),
    failed,
  });

  // What began and ended between two looks, too; and what is too old for the first page.
  const newlyEnded = async (gone, signal) => {
    const { items } = await getJson(listPath("/v1/jobs", { state: [...ENDED], limit: 20 }), { signal });
    const rest = gone.filter((id) => !items.some((job) => job.id === id));
    items.push(...(await Promise.all(rest.map((id) => getJson(`/v1/jobs/${id}`, { signal })))));
    const made = list(items, (...rows) => ended.prepend(...rows));
    if (made.length) say(`Finished: ${made.map(({ title }) => title).join("; ")}`);
  };

  const look = async (signal) => {
    const open = await openJobs(signal);
    const gone = [...rows.keys()].filter((id) => !open.some((job) => job.id === id));
    const held = gone.some((id) => rows.get(id).element.contains(document.activeElement));
    for (const id of gone) {
      rows.get(id).element.remove();
      rows.delete(id);
    }
    open.forEach((job, place) => {
      if (!rows.has(job.id)) rows.set(job.id, openRow(job, named(job), stop));
      const row = rows.get(job.id);
      row.update(job);
      if (waiting.children[place] !== row.element) waiting.insertBefore(row.element, waiting.children[place] ?? null);
    });
    $("#jobs-idle").hidden = open.length > 0;
    if (held) focusOn($("#jobs-title"));
    if (gone.length || !open.length) await newlyEnded(gone, signal);
  };

  const stop = async (id) => {
    try {
      await cancel(id);
    } catch (error) {
      if (error.status !== 409) { // it had ended already
        failed(error);
        return false;
      }
    }
    await look(watch.signal).catch(() => {}); // the next one comes soon
    return true;
  };

  const keepLooking = async (signal) => {
    for (let faulty = false; ; ) {
      await pause(rows.size ? BUSY : IDLE, signal);
      if (document.hidden) continue;
      try {
        await look(signal);
        if (faulty) fill(problem);
        faulty = false;
      } catch (error) {
        if (error.name === "AbortError" || error.status === 401) throw error;
        if (!faulty) failed(error); // once; polling continues
        faulty = true;
      }
    }
  };

  return {
    enter: async () => {
      watch = new AbortController();
      const { signal } = watch;
      fill(problem);
      try {
        await older();
        await look(signal);
        await keepLooking(signal);
      } catch (error) {
        if (error.name !== "AbortError") failed(error);
      }
    },
    leave: () => {
      watch.abort();
      rows.clear();
      done.clear();
      fill(waiting);
      fill(ended);
    },
  };
}

/** What waits and runs: running first, then by place in the queue. */
async function openJobs(signal) {
  const found = [];
  for (let after = ""; after !== null; ) {
    const { items, next } = await getJson(listPath("/v1/jobs", { state: OPEN, limit: 100, after }), { signal });
    const open = items.filter((job) => OPEN.includes(job.state));
    found.push(...open);
    after = open.length === items.length ? next : null;
  }
  const place = (job) => (job.state === "running" ? 0 : job.position ?? Infinity);
  return found.reverse().sort((a, b) => (place(a) === place(b) ? 0 : place(a) - place(b))); // else the oldest first
}

/** Have rows tell what only their assets and claims know: names and verdicts in words. */
async function tellMore(made) {
  for (const [kind, path, id] of [["embed", "/v1/assets", "asset_id"], ["verify", "/v1/claims", "claim_id"]]) {
    const wanting = made.filter((row) => row.wants === kind);
    if (!wanting.length) continue;
    const { items } = await getJson(listPath(path, { limit: 100 }));
    for (const row of wanting) {
      const [item] = items.filter((one) => one.id === row.result[id]);
      row.tell(item ?? (await getJson(`${path}/${row.result[id]}`).catch(() => null))); // deleted since, perhaps
    }
  }
}
