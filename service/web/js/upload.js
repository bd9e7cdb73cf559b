// Upload in pieces; after a broken connection it asks for the offset and continues there.
import { LOST, Problem, authorization, getJson, pause, postJson, problemOf } from "./api.js";
import { sha256 } from "./sha256.js";

const PIECE = 32 * 2 ** 20;
const PATIENCE = 8; // attempts without a byte of progress, about two minutes

/**
 * Bring a file to the service.
 *
 * @param {File} file
 * @param {(sent: number, waiting: boolean, digesting?: boolean) => void} tell  progress in bytes; waiting: the connection is
 *   down; digesting: nothing is sent yet
 * @param {AbortSignal} signal
 * @returns {Promise<object>} the upload: id, sha256, info
 */
export async function upload(file, tell, signal) {
  const announced = { name: file.name.slice(-200), size: file.size, sha256: await sha256(file, signal, (read) => tell(read, false, true)) };
  let slot = await postJson("/v1/uploads", announced, { signal });
  const path = `/v1/uploads/${slot.id}`;
  let offset = slot.offset;
  let failures = 0;
  while (slot.state !== "complete") {
    try {
      const piece = file.slice(offset, offset + PIECE);
      slot = await put(path, piece, offset, (sent) => tell(offset + sent, false), signal);
      if (slot.offset <= offset) throw new Problem({ title: LOST, detail: "The server did not receive the bytes." });
      failures = 0;
    } catch (error) {
      if (!passing(error) || failures >= PATIENCE) throw error;
      failures += 1;
      tell(offset, true);
      await pause(Math.min(30_000, 400 * 2 ** failures), signal);
      slot = await standing(path, slot, signal);
    }
    offset = slot.offset;
  }
  return slot;
}

/** Whether trying again can help: no connection, a gateway's answer, bytes that arrived without a confirmation. */
const passing = (error) => error.title === LOST || [408, 409].includes(error.status) || error.status >= 502;

async function standing(path, last, signal) {
  try {
    return await getJson(path, { signal });
  } catch (error) {
    if (passing(error)) return last;
    throw error;
  }
}

// XMLHttpRequest, because fetch does not say how much of a body has been sent.
function put(path, piece, offset, tell, signal) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("PUT", path);
    for (const [name, value] of Object.entries(authorization())) request.setRequestHeader(name, value);
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.setRequestHeader("Upload-Offset", String(offset));
    const stop = () => request.abort();
    signal.addEventListener("abort", stop, { once: true });
    request.upload.onprogress = (event) => tell(event.loaded);
    request.onloadend = () => signal.removeEventListener("abort", stop);
    request.onabort = () => reject(new DOMException("stopped", "AbortError"));
    request.onerror = () => reject(new Problem({ title: LOST, detail: "The upload was interrupted." }));
    request.onload = () => {
      if (request.status === 200) resolve(JSON.parse(request.responseText));
      else reject(problemOf(request.responseText, request.status, request.getResponseHeader("x-request-id") ?? ""));
    };
    if (signal.aborted) request.onabort();
    else request.send(piece);
  });
}
