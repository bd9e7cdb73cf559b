// Where a model is, read from the table of a compressed PLY: each row bounds 256 Gaussians.

const quantile = (values, q) => values[Math.min(values.length - 1, Math.floor(q * values.length))];
const sorted = (values) => values.slice().sort();

/** From where to where most of it is; all of it where that is little more, so that no leaf is cut off. */
function span(low, high) {
  const [from, to] = [quantile(low, 0.05), quantile(high, 0.95)];
  const [least, most] = [quantile(low, 0.002), quantile(high, 0.998)];
  return most - least < 1.6 * (to - from) ? [least, most] : [from, to]; // else floaters are far away
}

/** Robust centre and radius in the viewer's frame (y up), and whether the model is a room seen from inside. */
export function bounds(buffer) {
  const head = new TextDecoder("latin1").decode(new Uint8Array(buffer, 0, Math.min(buffer.byteLength, 65536)));
  const end = head.indexOf("end_header\n") + "end_header\n".length;
  const [, count, properties] = /element chunk (\d+)\n((?:property float \w+\n)+)/.exec(head);
  const names = [...properties.matchAll(/property float (\w+)/g)].map((match) => match[1]);
  const table = new DataView(buffer, end, Number(count) * names.length * 4);
  const at = (row, name) => table.getFloat32((row * names.length + names.indexOf(name)) * 4, true);
  const column = (name) => Float64Array.from({ length: Number(count) }, (_, row) => at(row, name));
  const [low, high] = ["min", "max"].map((side) => ["x", "y", "z"].map((axis) => column(`${side}_${axis}`)));
  const middles = low.map((values, d) => values.map((value, row) => (value + high[d][row]) / 2));
  const spans = low.map((values, d) => span(sorted(values), sorted(high[d])));
  const center = spans.map(([from, to], d) => {
    const half = quantile(sorted(middles[d]), 0.5); // floaters move the ends, not this
    const middle = (from + to) / 2;
    return Math.abs(half - middle) < 0.25 * (to - from) ? middle : half;
  });
  const distances = sorted(middles[0].map((_, row) => Math.hypot(...middles.map((v, d) => v[row] - center[d]))));
  const radius = Math.max(quantile(distances, 0.9), ...spans.map(([from, to]) => (to - from) / 2), 1e-6);
  const inside = distances.filter((distance) => distance < 0.45 * radius).length / distances.length;
  return { center: [-center[0], -center[1], center[2]], radius, isRoom: distances.length > 20 && inside < 0.03 };
}
