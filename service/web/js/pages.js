// Lists of the service, page by page.
import { getJson } from "./api.js";

const FEW = () => (window.matchMedia("(max-width: 40rem)").matches ? 8 : 20); // on a phone, one list stands over the other

/** Path of a list's page: `params` may hold several values as an array; empty ones are left out. */
export function listPath(path, params) {
  const pairs = Object.entries(params).flatMap(([name, value]) => [value].flat().filter(Boolean).map((one) => [name, one]));
  return `${path}?${new URLSearchParams(pairs)}`;
}

/** Every entry of a list, all its pages. */
export async function getAll(path) {
  const items = [];
  for (let after = ""; after !== null; ) {
    const page = await getJson(listPath(path, { limit: 100, after }));
    items.push(...page.items);
    after = page.next;
  }
  return items;
}

/**
 * A list on the page that shows what was searched for, with a button for what is older.
 *
 * `params()` gives the parameters, `add(items, next)` puts a page's entries in and returns them, `clear()` takes all out.
 * Late answers to earlier requests are dropped. Returns what loads anew.
 */
export function pager({ path, params, add, clear, more, failed, limit = FEW() }) {
  let question = 0;
  let busy = false;
  const load = async (after) => {
    const mine = after ? question : (question += 1);
    busy = true;
    try {
      const { items, next } = await getJson(listPath(path, { ...params(), limit, after }));
      if (mine !== question) return;
      if (!after) clear();
      const [first] = add(items, next) ?? [];
      if (after && document.activeElement === more) first?.querySelector("a, button")?.focus(); // reading goes on there
      more.hidden = !next;
      more.onclick = () => busy || load(next);
    } catch (error) {
      if (mine === question) failed(error);
    } finally {
      if (mine === question) busy = false;
    }
  };
  return () => load("");
}

/** Call `act` once typing has paused. */
export function whenTyped(field, act) {
  let timer = 0;
  field.addEventListener("input", () => {
    clearTimeout(timer);
    timer = setTimeout(act, 250);
  });
}
