// Numbers and codes in plain words.

const STAGES = {
  "": "Waiting for its turn",
  screen: "Looking whether it already carries a mark",
  inspect: "Looking whether it already carries a mark",
  compile: "Making the kernels ready",
  read: "Reading the model",
  look: "Looking at the model from all sides",
  choose: "Trying what this scene needs",
  prune: "Leaving out what nobody sees",
  quantize: "Learning the code book",
  landmarks: "Noting landmarks, to recognise screenshots later",
  plan: "Planning a mark that nobody sees",
  embed: "Getting the model ready",
  refine: "Refining the mark",
  record: "Sealing the record",
  write: "Writing the marked model",
  preview: "Drawing the preview",
  "open record": "Opening the records",
  verify: "Holding the suspect against your records",
  register: "Finding how the suspect was moved and cut",
  "find camera": "Finding where the pictures were taken from",
  "read picture": "Reading the mark from the pictures",
  decide: "Weighing the evidence",
  model: "Reading the mark from the model",
  render: "Reading the mark from renders",
  image: "Reading the mark from the pictures",
  commit: "Writing it down",
};

/** What a stage of a job does, and how many of how many where it says so ("record 3 of 20"). */
export function stageWords(stage) {
  const many = /^record (\d+ of \d+)$/.exec(stage);
  if (many) return [STAGES.verify, many[1]];
  return [STAGES[stage] ?? stage.charAt(0).toUpperCase() + stage.slice(1), ""];
}

/** Colour of a verdict. */
export const TONES = { marked: "good", not_marked: "plain", inconclusive: "open" };

export const count = (number) => number.toLocaleString("en");

export function bytes(number) {
  const [unit, size] = number < 1e6 ? ["kB", 1e3] : number < 1e9 ? ["MB", 1e6] : ["GB", 1e9];
  return `${(number / size).toFixed(number / size < 10 ? 1 : 0)} ${unit}`;
}

export const when = (iso) =>
  iso ? new Date(iso).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" }) : "unknown";
