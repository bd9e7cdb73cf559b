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

const ENDING = /\.(?:compressed\.ply|ply|splat|ksplat|spz|sog|zip|glb|gltf)$/i;

/** What a marked model's file is called, without an ending: its name, as far as a file may be called so. */
export function fileStem({ label, id }) {
  const plain = label.replace(ENDING, "").replace(/[^\p{L}\p{M}\p{N}_.-]+/gu, "-").replace(/^[.-]+|[.-]+$/g, "");
  return [...plain].slice(0, 80).join("") || id;
}

export const count = (number) => number.toLocaleString("en");

export function bytes(number) {
  const [unit, size] = number < 1e6 ? ["kB", 1e3] : number < 1e9 ? ["MB", 1e6] : ["GB", 1e9];
  return `${(number / size).toFixed(number / size < 10 ? 1 : 0)} ${unit}`;
}

export const when = (iso) =>
  iso ? new Date(iso).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" }) : "unknown";

/** How long something took. */
export function took(seconds) {
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole} s`;
  const minutes = Math.floor(whole / 60);
  return minutes < 60 ? `${minutes} min ${whole % 60} s` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

/** A marked model's name, and whose copy it is. */
export const assetName = ({ label, id, copy_name: copy }) => (copy ? `${label || id}, copy for ${copy}` : label || id);

/** What the files of a claim in a list were called; empty where nobody knows. */
export function suspectName({ suspects: [first, ...others] = [] }) {
  return others.length ? `${first} and ${others.length} more` : first ?? "";
}

/** Whom a claim of a list is about: the suspect, and the model that it was held to be. */
export function claimNames(claim) {
  const label = claim.asset_label === null ? "a model deleted since" : claim.asset_label;
  const asset = claim.asset_id && label !== undefined && assetName({ id: claim.asset_id, label, copy_name: claim.copy_name });
  return [suspectName(claim), asset].filter(Boolean).join(" against ");
}
