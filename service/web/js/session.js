// The API key, and the names of the jobs that this tab started: kept in this tab only, gone when the tab closes.

const NAME = "mark3dgs.api-key";
const JOBS = "mark3dgs.jobs";
const MOST_JOBS = 200;
const listeners = new Set();

export const apiKey = () => sessionStorage.getItem(NAME) ?? "";

export function setApiKey(key) {
  if (key) sessionStorage.setItem(NAME, key);
  else for (const name of [NAME, JOBS]) sessionStorage.removeItem(name);
  for (const tell of listeners) tell(key);
}

/** Call `tell` at every change of the key. */
export function onApiKey(tell) {
  listeners.add(tell);
}

const jobs = () => JSON.parse(sessionStorage.getItem(JOBS) ?? "[]");

/** Remember what a job is about: its copy's name, too, which the service does not say. */
export function nameJob(id, name) {
  sessionStorage.setItem(JOBS, JSON.stringify([...jobs(), [id, name]].slice(-MOST_JOBS)));
}

/** What a job is about; empty where another tab or program started it. */
export const jobName = (id) => new Map(jobs()).get(id) ?? "";
