// What an administrator enters once: the owner's name and the service's address; and API keys with chosen scopes.
import { postJson, request } from "./api.js";
import { copyButton } from "./copy.js";
import { $, fill, h, say } from "./dom.js";
import { pager } from "./pages.js";
import { showProblem } from "./problem.js";
import { signIn, who } from "./session.js";
import { when } from "./words.js";

const SCOPES = {
  embed: "Mark models, and fetch what was marked",
  verify: "Check suspects, and share claims",
  read: "See all marked models, claims and jobs",
  originals: "Fetch unmarked originals and records",
  admin: "All of this, owner keys and these settings",
};

/** Wire the view; `done` leaves it after the first entry. */
export function startSettings(done) {
  const [name, address] = [$("#owner-name"), $("#owner-url")];
  const keys = startApiKeys();

  const enter = () => {
    const { service, is_named: named, name: owner } = who();
    $("#settings-title").textContent = named ? "Settings" : "Who is the owner?";
    $("#settings-first").hidden = $("#owner-later").hidden = named;
    $("#api-keys").hidden = !named;
    name.value = named ? owner : "";
    address.value = service.public_url;
    address.disabled = !service.may_set_public_url;
    $("#owner-url-fixed").hidden = service.may_set_public_url;
    if (service.may_set_public_url && !service.public_url && location.protocol === "https:") address.value = location.origin;
    fill($("#owner-problem"));
    if (named) keys.enter();
  };

  $("#owner-later").addEventListener("click", done);
  $("#owner-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const first = !who().is_named;
    const changed = address.disabled ? {} : { public_url: address.value.trim() || null };
    try {
      signIn(await (await request("/v1/me", { method: "PATCH", json: { name: name.value.trim(), ...changed } })).json());
      if (first) done();
      else enter();
      say("Saved");
    } catch (error) {
      showProblem($("#owner-problem"), error);
    }
  });
  return { enter, leave: keys.leave };
}

/** The keys of the tenant, and the form that makes one. */
function startApiKeys() {
  const [list, made, problem, label] = ["list", "made", "problem", "label"].map((part) => $(`#api-key-${part}`));
  const failed = (error) => showProblem(problem, error);
  const load = pager({
    path: "/v1/api-keys",
    params: () => ({}),
    clear: () => fill(list),
    add: (items) => {
      const lines = items.map((key) => line(key, load, failed));
      list.append(...lines);
      return lines;
    },
    more: $("#api-key-more"),
    failed,
  });
  fill($("#api-key-scopes"), h("legend", {}, "Scopes"), Object.entries(SCOPES).map(([scope, text]) =>
    h("label", {}, h("input", { type: "checkbox", name: "scope", value: scope }), h("span", {}, scope, h("small", {}, text)))));
  $("#api-key-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    fill(problem);
    const chosen = [...event.target.querySelectorAll("[name=scope]:checked")];
    if (!chosen.length) {
      failed({ title: "No scope selected", detail: "Select what the key may do." });
      return;
    }
    try {
      const { token } = await postJson("/v1/api-keys", { label: label.value.trim(), scopes: chosen.map((box) => box.value) });
      event.target.reset(); // before the key stands in it
      const field = h("input", { id: "api-key-token", class: "mono", readonly: true, value: token, onfocus: () => field.select() });
      fill(made, h("label", { for: "api-key-token" }, "The new API key"),
        h("div", { class: "with-button" }, field, copyButton(() => token, "the API key")),
        h("p", { class: "help" }, "Shown only now."));
      field.focus();
      await load();
    } catch (error) {
      failed(error);
    }
  });
  return {
    enter: () => {
      fill(problem);
      load();
    },
    leave: () => {
      fill(made);
      fill(list);
    },
  };
}

function line({ id, label, scopes, created_at: made, revoked_at: revoked }, changed, failed) {
  const state = revoked ? `revoked ${when(revoked)}` : `created ${when(made)}`;
  const revoke = h("button", { type: "button", class: "quiet" }, "Revoke", h("span", { class: "unseen" }, ` ${label || id}`));
  revoke.addEventListener("click", async () => {
    try {
      await request(`/v1/api-keys/${id}`, { method: "DELETE" });
      await changed();
      say("Revoked");
    } catch (error) {
      failed(error);
    }
  });
  return h("li", { class: "line" }, h("strong", {}, label || `mk_${id}`), h("span", {}, `${scopes.join(", ")} · ${state}`),
    revoked || id === who().key.id ? null : revoke);
}
