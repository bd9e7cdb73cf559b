// Two models, one camera: the original and the marked one, turned together.
import { getBlob } from "./api.js";
import { bounds } from "./bounds.js";
import { fill, h } from "./dom.js";
import { Orbit } from "./orbit.js";

const FORMAT = "compressed.ply"; // the smallest that both sides read and write at once
const FIELD_OF_VIEW = 45;
const OFF = { enabled: false };
const SETTINGS = {
  version: 2,
  tonemapping: "none",
  highPrecisionRendering: false,
  background: { color: [0, 0, 0] },
  postEffectSettings: {
    sharpness: { ...OFF, amount: 0 },
    bloom: { ...OFF, intensity: 0.1, blurLevel: 2 },
    grading: { ...OFF, brightness: 1, contrast: 1, saturation: 1, tint: [1, 1, 1] },
    vignette: { ...OFF, intensity: 0.5, inner: 0.3, outer: 0.75, curvature: 1 },
    fringing: { ...OFF, intensity: 0.5 },
  },
  animTracks: [],
  cameras: [{ initial: { position: [0, 0, 1], target: [0, 0, 0], fov: FIELD_OF_VIEW } }],
  annotations: [],
  startMode: "default",
};

/** A viewer of an asset's two versions; the models come once `load` is called. */
export class Viewer {
  #handles = [];
  #stop = new AbortController();

  constructor(asset) {
    this.asset = asset;
    this.status = h("p", { class: "help", role: "status" });
    this.panes = [pane("Original"), pane("Marked")];
    this.stage = h("div", { class: "viewer-stage", tabindex: "0", role: "application",
      "aria-label": "Original and marked model in 3D. Arrow keys rotate, plus and minus zoom, Home resets." },
      this.panes);
    this.controls = h("div", { class: "viewer-controls", role: "group", "aria-label": "Camera" });
    this.element = h("div", { class: "viewer" }, this.stage, this.controls, this.status);
  }

  async load() {
    this.status.textContent = "Loading both models…";
    try {
      const path = (version) => `/v1/assets/${this.asset.id}/model?format=${FORMAT}&version=${version}`;
      const [code, ...blobs] = await Promise.all([
        import("../viewer/supersplat/index.js"),
        ...["original", "marked"].map((version) => getBlob(path(version), { signal: this.#stop.signal })),
      ]);
      const where = bounds(await blobs[0].arrayBuffer());
      this.status.textContent = "Drawing…";
      this.orbit = new Orbit(where, () => this.#redraw());
      this.#handles = await Promise.all(blobs.map((blob, k) => this.#show(code, blob, this.panes[k])));
      this.orbit.listen(this.stage);
      this.#makeControls();
      this.status.textContent = "Drag to rotate, wheel or pinch to zoom. Both views move together.";
      this.stage.dataset.ready = "yes";
    } catch (error) {
      if (error.name === "AbortError") return;
      this.status.textContent = `The 3D view could not be opened: ${error.message}`;
    }
  }

  destroy() {
    this.#stop.abort();
    for (const handle of this.#handles) handle.destroy();
    this.#handles = [];
  }

  async #show(code, blob, container) {
    const url = URL.createObjectURL(blob);
    const handle = await code.createViewer({
      container, settings: SETTINGS, contentUrl: url, contentFilename: `model.${FORMAT}`,
      renderer: "webgl", // what every machine has
      ui: false, noanim: true,
    });
    handle.state.inputEnabled = false; // the orbit moves the camera, in both
    const camera = handle.app.root.findComponent("camera");
    // After the viewer's own update, before the frame is drawn.
    handle.app.on("prerender", () => {
      const { position, target, distance, radius } = this.orbit;
      camera.entity.setPosition(...position);
      camera.entity.lookAt(...target);
      Object.assign(camera, {
        fov: FIELD_OF_VIEW, horizontalFov: false, nearClip: distance / 100, farClip: distance + radius * 100,
      });
    });
    if (this.#stop.signal.aborted) handle.destroy();
    else if (!handle.state.loaded) await new Promise((resolve) => handle.events.once("loaded:changed", resolve));
    URL.revokeObjectURL(url);
    return handle;
  }

  #redraw() {
    for (const handle of this.#handles) handle.app.renderNextFrame = true;
  }

  #makeControls() {
    const { orbit } = this;
    const button = (text, label, click) =>
      h("button", { type: "button", class: "small", "aria-label": label, title: label, onclick: click }, text);
    const flip = h("button", { type: "button", class: "small wide", "aria-pressed": "false" }, "Switch original / marked");
    flip.addEventListener("click", () => this.#flip(flip));
    fill(this.controls,
      button("←", "Turn left", () => orbit.turn(-15, 0)), button("→", "Turn right", () => orbit.turn(15, 0)),
      button("↑", "Turn up", () => orbit.turn(0, -10)), button("↓", "Turn down", () => orbit.turn(0, 10)),
      button("+", "Nearer", () => orbit.zoom(0.8)), button("−", "Farther", () => orbit.zoom(1.25)),
      h("button", { type: "button", class: "small wide", onclick: () => orbit.reset() }, "Reset"), flip);
  }

  // Side by side -> the original alone -> the marked one in the same place -> ...: what flickers is the mark.
  #flip(button) {
    const next = { undefined: "0", 0: "1", 1: undefined }[this.stage.dataset.alone];
    if (next === undefined) delete this.stage.dataset.alone;
    else this.stage.dataset.alone = next;
    button.setAttribute("aria-pressed", String(next !== undefined));
    button.textContent = { undefined: "Switch original / marked", 0: "Show marked", 1: "Side by side" }[next];
  }
}

const pane = (name) => h("div", { class: "pane" }, h("span", { class: "pane-name" }, name));
