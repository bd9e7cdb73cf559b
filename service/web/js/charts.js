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

/** One cell for each bit: filled where it is 1, faint where it is unsure, struck where it differs. */
export function bits({ hex, registered, bits: length, reliability }, said) {
  const digits = (text) => [...text].flatMap((digit) => [...parseInt(digit, 16).toString(2).padStart(4, "0")]).slice(0, length);
  const [read, meant] = [digits(hex), digits(registered)];
  const cells = read.map((bit, k) => {
    const cell = h("i", { class: `${bit === "1" ? "one" : "zero"}${bit === meant[k] ? "" : " wrong"}`,
      title: `bit ${k + 1}: ${bit}, registered ${meant[k]}, read right with probability ${reliability[k].toFixed(3)}` });
    cell.style.setProperty("--sure", Math.max(0.15, 2 * reliability[k] - 1));
    return cell;
  });
  return h("div", { class: "bits", role: "img", "aria-label": said }, cells);
}
