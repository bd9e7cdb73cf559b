// Requests to the service, and its errors (problem+json).
import { apiKey } from "./session.js";

/** What the service (or the network) said instead of an answer. */
export class Problem extends Error {
  constructor({ title, detail, status = 0, type = "", request_id = "", ...extra }) {
    super(detail || title);
    Object.assign(this, { title, detail, status, type, requestId: request_id, extra });
  }
}

export const LOST = "The connection was lost";

export const authorization = () => ({ Authorization: `Bearer ${apiKey()}` });

/** The problem that a response holds, whatever it holds. */
export function problemOf(text, status, requestId) {
  try {
    const plain = JSON.parse(text);
    if (plain.title) return new Problem({ ...plain, request_id: plain.request_id ?? requestId });
  } catch {
    // not from the service itself, such as a proxy's page
  }
  return new Problem({ title: `The server answered ${status}`, detail: text.slice(0, 200), status, request_id: requestId });
}

/** A response that is fine; throws a Problem otherwise. */
export async function request(path, { method = "GET", json, body, headers = {}, signal } = {}) {
  const options = { method, body, headers: { ...authorization(), ...headers }, signal };
  if (json !== undefined) {
    options.body = JSON.stringify(json);
    options.headers["Content-Type"] = "application/json";
  }
  let response;
  try {
    response = await fetch(path, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem({ title: LOST, detail: "The service does not answer. Is it running?" });
  }
  if (response.ok) return response;
  throw problemOf(await response.text(), response.status, response.headers.get("x-request-id") ?? "");
}

export const getJson = async (path, options) => (await request(path, options)).json();

export const postJson = async (path, json, options) =>
  (await request(path, { method: "POST", json, ...options })).json();

/** POST that is done once however often it is sent: it is sent again when the connection breaks. */
export async function postOnce(path, json, signal) {
  const key = [...crypto.getRandomValues(new Uint8Array(16))].map((b) => b.toString(16).padStart(2, "0")).join("");
  for (let attempt = 0; ; attempt += 1) {
    try {
      return await postJson(path, json, { headers: { "Idempotency-Key": key }, signal });
    } catch (error) {
      if (error.title !== LOST || attempt === 4) throw error;
      await pause(500 * 2 ** attempt, signal);
    }
  }
}

/** Wait; rejects at once when the signal aborts. */
export function pause(milliseconds, signal) {
  return new Promise((resolve, reject) => {
    const stop = () => {
      clearTimeout(timer);
      reject(new DOMException("stopped", "AbortError"));
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, milliseconds);
    if (signal?.aborted) stop();
    else signal?.addEventListener("abort", stop, { once: true });
  });
}

/** A file of the service as a blob (the key cannot travel in a plain link). */
export const getBlob = async (path, options) => (await request(path, options)).blob();

/** Save a file of the service under a name. */
export async function download(path, name) {
  save(await getBlob(path), name);
}

/** Hand a blob to the user as a file. */
export function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
