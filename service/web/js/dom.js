// Small helpers around the DOM.

export const $ = (selector, root = document) => root.querySelector(selector);

/** An element: h("p", {class: "note"}, "text", child). Properties that start with "on" are listeners. */
export function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "value") element.value = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

let made = 0;

/** An id that nothing else has: a claim may be on the page twice, as what was just found and by itself. */
export const fresh = (name) => `${name}-${(made += 1)}`;

/** Put new children in place of the old ones. */
export function fill(element, ...children) {
  element.replaceChildren(...children.flat().filter((child) => child !== null && child !== undefined));
}

/** Tell those who hear the page. */
export const say = (text) => ($("#said").textContent = text);

/** Show one of several elements, hide the others. */
export function only(shown, ...all) {
  for (const element of all) element.hidden = element !== shown;
}

/** Move the focus (and with it a screen reader) to a heading or an alert. */
export function focusOn(element) {
  if (!element.hasAttribute("tabindex")) element.setAttribute("tabindex", "-1");
  element.focus({ preventScroll: true });
  element.scrollIntoView({ block: "nearest" });
}

/** A term and its value, for a description list. */
export const fact = (term, ...value) => h("div", {}, h("dt", {}, term), h("dd", {}, ...value));
