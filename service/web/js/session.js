// The API key: kept in this tab only, gone when the tab closes.

const NAME = "mark3dgs.api-key";
const listeners = new Set();

export const apiKey = () => sessionStorage.getItem(NAME) ?? "";

export function setApiKey(key) {
  if (key) sessionStorage.setItem(NAME, key);
  else sessionStorage.removeItem(NAME);
  for (const tell of listeners) tell(key);
}

/** Call `tell` at every change of the key. */
export function onApiKey(tell) {
  listeners.add(tell);
}
