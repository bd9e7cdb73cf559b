// The API key, what it may do, and the names of the jobs that this tab started: kept in this tab only.

const NAME = "mark3dgs.api-key";
const JOBS = "mark3dgs.jobs";
const MOST_JOBS = 200;
const listeners = new Set();
let me = null; // GET /v1/me of the key

export const apiKey = () => sessionStorage.getItem(NAME) ?? "";

export function setApiKey(key) {
  me = null;
  if (key) sessionStorage.setItem(NAME, key);
  else for (const name of [NAME, JOBS]) sessionStorage.removeItem(name);
  for (const tell of listeners) tell(key);
}

/** Keep what the service says of the key: the answer of /v1/me. */
export function signIn(answer) {
  me = answer;
}

/** The key, its tenant and the service, once signed in; null before. */
export const who = () => me;

/** Whether the key has a scope. */
export const may = (scope) => me.key.scopes.some((one) => one === scope || one === "admin");

/** Whether the service has an optional part. */
export const has = (part) => me.service.parts.includes(part);

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
