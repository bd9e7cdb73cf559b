// An address under which others read the report for a time, without an API key.
import { getJson, postJson, request } from "./api.js";
import { copyButton } from "./copy.js";
import { fill, fresh, h, say } from "./dom.js";
import { problemBox } from "./problem.js";
import { when } from "./words.js";

const DAYS = [7, 14, 30, 90];

/** The control: {element, opened()}; it stays hidden where the service knows no such addresses, or not for this key. */
export function shareForm(claim) {
  const path = `/v1/claims/${claim.claim_id}`;
  const [daysId, urlId] = [fresh("share-days"), fresh("share-url")];
  const days = h("select", { id: daysId }, DAYS.map((many) => h("option", { value: many }, `${many} days`)));
  days.value = 14;
  const button = h("button", {}, "Create a link");
  const [made, problem] = [h("div"), h("div")];
  const list = h("ul", { class: "shares", "aria-label": "Links to this report" });

  const fails = (error) => fill(problem, problemBox(error));
  const refresh = async () => {
    const { items } = await getJson(`${path}/shares`);
    fill(list, items.map((share) => line(share, async () => {
      await request(`/v1/shares/${share.id}`, { method: "DELETE" });
      if (made.dataset.share === share.id) fill(made);
      await refresh();
      say("Revoked");
      button.focus();
    }, fails)));
  };
  const make = async (event) => {
    event.preventDefault();
    fill(problem);
    button.disabled = true; // a second click would make a second address
    try {
      const { url, id, expires_at: until } = await postJson(`${path}/share`, { days: Number(days.value) });
      const address = new URL(url, window.location.href).href;
      const field = h("input", { id: urlId, readonly: true, value: address, onfocus: () => field.select() });
      made.dataset.share = id;
      fill(made, h("label", { for: urlId }, "Link to the report"),
        h("div", { class: "with-button" }, field, copyButton(() => address, "the link")),
        h("p", { class: "help" }, `Shown only now. Everyone with this link can read the report, the signed claim and the pack until ${when(until)}.`));
      field.focus();
      await refresh();
    } catch (error) {
      fails(error);
    } finally {
      button.disabled = false;
    }
  };
  const element = h("details", { class: "card more", hidden: true },
    h("summary", {}, "Share the report"),
    h("form", { onsubmit: make },
      h("p", { class: "help" }, "A platform or a lawyer can read the report without an API key."),
      h("label", { for: daysId }, "Valid for"), days, problem, made, button, list));
  const opened = async () => {
    try {
      await refresh();
      element.hidden = false;
    } catch (error) {
      element.hidden = error.status === 404 || error.status === 403;
      if (!element.hidden) fails(error);
    }
  };
  return { element, opened };
}

function line(share, revoke, fails) {
  const until = when(share.expires_at);
  const button = h("button", { type: "button", class: "quiet" }, "Revoke", h("span", { class: "unseen" }, ` the link until ${until}`));
  button.addEventListener("click", () => revoke().catch(fails));
  return h("li", {}, h("span", {}, `Until ${until}`), button);
}
