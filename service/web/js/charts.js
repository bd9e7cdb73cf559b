// The two drawings of a claim: the bound on a log scale, and the bits.
import { h } from "./dom.js";

/** A bound on a log scale with its thresholds; `said` is it in words. */
export function scale(log10, limits, said) {
  const least = Math.min(log10, ...limits.map((limit) => limit.log10));
  const place = (value) => Math.min(1, Math.log1p(-value) / Math.log1p(-least * 1.15)); // 10^-9 and 10^-5000 on one line
  const bar = h("div", { class: "scale-bar" });
  bar.style.setProperty("--part", place(Math.min(0, log10)));
  const shown = limits.filter((limit, k) => k === 0 || limit.log10 < limits[0].log10 - 1); // else one hides the other
  const marks = shown.map(({ log10: at, text }, k) => {
    const mark = h("div", { class: `scale-mark ${k % 2 ? "below" : "above"} ${place(at) > 0.5 ? "left" : "right"}` }, h("span", {}, text));
    mark.style.setProperty("--at", place(at));
    return mark;
  });
  const label = [said, ...limits.map(({ text }) => text)].join("; ");
  return h("div", { class: `scale ${log10 <= limits[0].log10 ? "met" : "unmet"}`, role: "img", "aria-label": label }, bar, ...marks);
}

/** The bits of a reading with their values: as registered, as read, and how surely. */
export function bits({ bits: { string: read }, registered_bits: { string: meant }, reliability }, said) {
  const cell = (bit, kind = "") => h("i", { class: `${bit === "1" ? "one" : "zero"} ${kind}` }, bit);
  const columns = [...read].map((bit, k) => {
    const sure = h("b", {});
    sure.style.setProperty("--sure", Math.max(0, 2 * reliability[k] - 1));
    const title = `bit ${k + 1}: read ${bit}, registered ${meant[k]}, read right with probability ${reliability[k].toFixed(3)}`;
    return h("span", { title }, cell(meant[k]), cell(bit, bit === meant[k] ? "" : "wrong"), sure);
  });
  const heads = h("span", { class: "heads" }, ["registered", "read", "reliability"].map((name) => h("i", {}, name)));
  return h("div", {},
    h("div", { class: "bits", role: "img", "aria-label": said }, heads, columns),
    h("p", { class: "help" }, "Filled is 1, empty is 0, ? was not read; a red frame marks a bit that differs. Reliability",
      " runs from empty (pure chance) to full (certain). The check used your record, which says where the bits are."));
}
