// Numbers and codes in plain words.

const STAGES = {
  "": "Queued",
  screen: "Searching for an existing watermark",
  inspect: "Searching for an existing watermark",
  compile: "Compiling kernels",
  read: "Reading the file",
  look: "Rendering the key views",
  choose: "Choosing the settings",
  prune: "Pruning to the quality budget",
  quantize: "Learning the codebook",
  landmarks: "Building the landmark database",
  plan: "Planning the watermark",
  embed: "Embedding the watermark",
  mark: "Embedding the watermark",
  refine: "Refining the watermark",
  record: "Sealing the record",
  write: "Writing the marked model",
  preview: "Rendering the preview",
  picture: "Rendering the pictures",
  "open record": "Opening the records",
  verify: "Comparing the suspect with your records",
  register: "Registering the suspect",
  displacements: "Measuring displacements",
  "find camera": "Finding the cameras of the pictures",
  "read picture": "Extracting bits from the pictures",
  decide: "Evaluating the evidence",
  model: "Extracting bits from the model",
  render: "Extracting bits from renders",
  image: "Extracting bits from the pictures",
  commit: "Saving the result",
};

/** What a stage of a job does, and what it has reached where that is known ("record 3 of 20", "prune: 37.5 dB"). */
export function stageWords(stage) {
  const many = /^record (\d+ of \d+)$/.exec(stage);
  if (many) return [STAGES.verify, many[1]];
  const [name, reached = ""] = stage.split(": ");
  return [STAGES[name] ?? name.charAt(0).toUpperCase() + name.slice(1), reached];
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

/** What the files of a claim in a list were called; empty if unknown. */
export function suspectName({ suspects: [first, ...others] = [] }) {
  return others.length ? `${first} and ${others.length} more` : first ?? "";
}

/** Whom a claim of a list is about: the suspect, and the model that it was held to be. */
export function claimNames(claim) {
  const label = claim.asset_label === null ? "a deleted model" : claim.asset_label;
  const asset = claim.asset_id && label !== undefined && assetName({ id: claim.asset_id, label, copy_name: claim.copy_name });
  return [suspectName(claim), asset].filter(Boolean).join(" against ");
}
