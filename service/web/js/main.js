// The page: which view is shown, by the part of the address after "#".
import { getJson } from "./api.js";
import { assetView } from "./asset.js";
import { claimView } from "./claim.js";
import { $, fill, focusOn, h } from "./dom.js";
import { startEmbed } from "./embed.js";
import { startJobs } from "./joblist.js";
import { startLibrary } from "./library.js";
import { showProblem } from "./problem.js";
import { apiKey, may, onApiKey, setApiKey, signIn, who } from "./session.js";
import { startSettings } from "./settings.js";
import { startVerify } from "./verify.js";

const SCOPES = { mark: "embed", check: "verify", jobs: "read", library: "read", settings: "admin" }; // of each view
const TITLES = { mark: "Mark a model", check: "Check a suspect", jobs: "Jobs", library: "Library", settings: "Settings" };
let item = null; // the asset shown on a page of its own, with its 3D view

const views = { mark: startEmbed(), check: startVerify(), jobs: startJobs(), library: startLibrary() };
views.settings = startSettings(() => (location.hash = "#mark"));

async function show(moveFocus) {
  const [view, id] = location.hash.slice(1).split("/");
  const open = who() ? Object.keys(SCOPES).filter((one) => may(SCOPES[one])) : [];
  const name = open.includes(view) || id ? view : open[0];
  item?.destroy?.();
  item = null;
  views.jobs.leave(); // it keeps asking while it is shown
  const shown = !who() ? "gate" : id ? "view-item" : name ? `view-${name}` : "view-none";
  for (const section of document.querySelectorAll("main > section")) section.hidden = section.id !== shown;
  for (const link of document.querySelectorAll(".top nav a")) {
    const current = link.hash === `#${name}` || (id && link.hash === "#library");
    if (current) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
    link.hidden = !open.includes(link.hash.slice(1));
  }
  document.title = `${TITLES[name] ?? "Library"} · Mark3DGS`;
  const key = $("#key-state");
  key.hidden = !who();
  $("#views").hidden = !open.length;
  if (shown === "gate") {
    if (moveFocus) $("#api-key").focus();
    return;
  }
  if (id) await showItem(name, id);
  else views[name]?.enter();
  if (moveFocus) focusOn($(`#${shown} h1`) ?? $(`#${shown} h2`) ?? $("#main"));
}

async function showItem(kind, id) {
  const place = $("#view-item");
  fill(place, h("p", { role: "status" }, "Loading…"));
  try {
    const plain = await getJson(`/v1/${kind === "claim" ? "claims" : "assets"}/${encodeURIComponent(id)}`);
    item = kind === "claim" ? claimView(plain, { add: views.check.add }) : assetView(plain);
    fill(place, h("p", { class: "crumb" }, h("a", { href: "#library" }, "← Library")), item.element);
    item.opened?.();
  } catch (error) {
    showProblem(place, error);
  }
}

function startGate() {
  $("#gate-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const field = $("#api-key");
    setApiKey(field.value.trim());
    try {
      signIn(await getJson("/v1/me"));
      field.value = "";
      fill($("#gate-problem"));
      if (!who().is_named && may("admin") && !location.hash.includes("/")) history.replaceState(null, "", "#settings");
      show(true);
    } catch (error) {
      setApiKey("");
      showProblem($("#gate-problem"), error);
    }
  });
  $("#key-state").addEventListener("click", () => setApiKey(""));
  onApiKey((key) => {
    if (key) return;
    for (const view of Object.values(views)) view.leave();
    fill($("#view-item"));
    show(true);
  });
}

startGate();
window.addEventListener("hashchange", () => {
  if (location.hash !== "#main") show(true);
});
if (apiKey()) {
  await getJson("/v1/me").then(signIn, (error) => {
    if (error.status === 401) setApiKey("");
    showProblem($("#gate-problem"), error);
  });
}
show(false);
