// Ids and digests with a button that copies them whole.
import { h, say } from "./dom.js";

const SHORT = 20; // characters; what is more than twice as long is shortened to that

/** A text, and a button to copy it; `what` it is, for the button's name. A long one shows its ends alone, unless `whole`. */
export function copyable(text, what, whole = false) {
  const shown = text.length > 2 * SHORT && !whole ? `${text.slice(0, SHORT - 6)}…${text.slice(-6)}` : text;
  return h("span", { class: "copyable" }, h("code", { title: text }, shown), copyButton(() => text, what));
}

/** The button alone; `text` is called when it is pressed. */
export function copyButton(text, what) {
  const word = h("span", {}, "Copy");
  const button = h("button", { type: "button", class: "copy" }, word, h("span", { class: "unseen" }, ` ${what}`));
  button.addEventListener("click", async () => {
    word.textContent = (await toClipboard(text())) ? "Copied" : "Not copied";
    button.focus();
    say(`${word.textContent}: ${what}`);
    setTimeout(() => (word.textContent = "Copy"), 2000);
  });
  return button;
}

async function toClipboard(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    // not there without TLS, or not allowed: the old way
  }
  const field = h("textarea", { class: "unseen", value: text });
  document.body.append(field);
  field.select();
  const done = document.execCommand("copy");
  field.remove();
  return done;
}
