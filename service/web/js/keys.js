// Owner keys: choose one, or make one and keep a copy.
import { postJson, save } from "./api.js";
import { $, fill, h, only } from "./dom.js";
import { getAll } from "./pages.js";
import { showProblem } from "./problem.js";
import { may } from "./session.js";

let asked = 0;

/** List the keys; with none, the form to make one is open at once. Who may not see or make them has the only one. */
export async function listKeys() {
  const turn = ++asked;
  const items = may("read") ? await getAll("/v1/keys") : [];
  if (turn !== asked) return; // a later question was answered first
  const select = $("#mark-key");
  const chosen = select.value;
  fill(select, items.map((key) =>
    h("option", { value: key.id }, key.label ? `${key.label} (${key.fingerprint.slice(0, 8)})` : key.fingerprint)));
  if (items.some((key) => key.id === chosen)) select.value = chosen;
  $("#key-new").hidden = !may("admin");
  if (!items.length && !may("admin")) fill(select, h("option", { value: "" }, "The owner’s only key"));
  const none = select.options.length === 0;
  $("#key-cancel").hidden = none;
  showMaking(none || !$("#key-make").hidden); // who is making a key is not interrupted
}

/** Empty the list of owner keys. A list that was requested before and arrives later is ignored. */
export function dropKeys() {
  asked++;
  fill($("#mark-key"));
}

/** Id of the chosen key, made if its form is open; "" for the owner's only one, undefined where none could be made. */
export async function chosenKey() {
  if ($("#mark-key").disabled && !(await make())) return undefined;
  return $("#mark-key").value;
}

/** Wire the buttons. */
export function startKeys() {
  $("#key-new").addEventListener("click", () => {
    showMaking(true);
    $("#key-label").focus();
  });
  $("#key-cancel").addEventListener("click", () => {
    showMaking(false);
    $("#key-new").focus();
  });
  $("#key-create").addEventListener("click", make);
  $("#key-label").addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault(); // Enter here makes the key; it does not send the form around it
    make();
  });
}

function showMaking(making) {
  only(making ? $("#key-make") : $("#key-choice"), $("#key-make"), $("#key-choice"));
  $("#mark-key").disabled = making; // a required field that is hidden would block the form
}

async function make() {
  const button = $("#key-create");
  const label = $("#key-label");
  button.disabled = true;
  let done = false;
  try {
    const reveal = $("#key-reveal").checked;
    const made = await postJson("/v1/keys", { label: label.value.trim(), reveal });
    if (made.key) save(new Blob([made.key], { type: "text/plain" }), `${made.fingerprint}.key`);
    label.value = "";
    fill($("#key-problem"));
    await listKeys();
    showMaking(false);
    $("#mark-key").value = made.id;
    $("#mark-key").focus();
    done = true;
  } catch (error) {
    showProblem($("#key-problem"), error);
  } finally {
    button.disabled = false;
  }
  return done;
}
