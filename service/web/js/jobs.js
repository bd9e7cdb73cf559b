// Following a job to its end: server-sent events, and plain questions where those do not come through.
import { LOST, getJson, pause, request } from "./api.js";

const PATIENCE = 120; // seconds without an answer; the job goes on meanwhile
export const ENDED = new Set(["succeeded", "disputed", "failed", "cancelled"]);

/** The job once it has ended; `tell` sees it at every change. */
export async function follow(id, tell, signal) {
  for (let failures = 0; ; ) {
    try {
      for await (const job of events(`/v1/jobs/${id}/events`, signal)) {
        failures = 0;
        tell(job);
        if (ENDED.has(job.state)) return job;
      }
    } catch (error) {
      if (error.title !== LOST) throw error;
    }
    try {
      const job = await getJson(`/v1/jobs/${id}`, { signal });
      failures = 0;
      tell(job);
      if (ENDED.has(job.state)) return job;
    } catch (error) {
      if (error.title !== LOST || failures >= PATIENCE) throw error;
      failures += 1;
    }
    await pause(1000, signal);
  }
}

export const cancel = (id) => request(`/v1/jobs/${id}`, { method: "DELETE" });

// EventSource cannot send the API key, so the stream is read by hand.
async function* events(path, signal) {
  const response = await request(path, { headers: { Accept: "text/event-stream" }, signal });
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  try {
    for (;;) {
      let done, value;
      try {
        ({ done, value } = await reader.read());
      } catch (error) {
        if (error.name === "AbortError") throw error;
        return; // the connection broke; the caller tries again
      }
      if (done) return;
      text += value.replaceAll("\r\n", "\n");
      const parts = text.split("\n\n");
      text = parts.pop();
      for (const part of parts) {
        const data = part.split("\n").filter((line) => line.startsWith("data:")).map((line) => line.slice(5).trim());
        if (data.length) yield JSON.parse(data.join("\n"));
      }
    }
  } finally {
    reader.cancel().catch(() => {});
  }
}
