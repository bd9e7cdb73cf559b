// A viewer's own reader of KHR_gaussian_splatting: node playcanvas_glb.mjs SPLAT_TRANSFORM SCENE.glb OUT
// OUT: float32 columns of all Gaussians, one after the other, in the order of its names, which are printed as JSON.
import { readFileSync, realpathSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [program, scene, out] = process.argv.slice(2);
const engine = createRequire(realpathSync(program)).resolve("playcanvas"); // splat-transform depends on it
const pc = await import(new URL("playcanvas.mjs", pathToFileURL(engine)));
const nothing = () => {};
globalThis.document ??= { createElement: () => ({ getContext: () => null }), addEventListener: nothing };
const box = () => ({ width: 8, height: 8 });
const canvas = { getBoundingClientRect: box, width: 8, height: 8, addEventListener: nothing, style: {} };
const options = new pc.AppOptions();
options.graphicsDevice = new pc.NullGraphicsDevice(canvas);
options.componentSystems = [pc.GSplatComponentSystem];
options.resourceHandlers = [pc.ContainerHandler, pc.TextureHandler];
const app = new pc.AppBase(canvas);
app.init(options);
const contents = new Uint8Array(readFileSync(scene)).buffer;
const asset = new pc.Asset("scene", "container", { url: "scene.glb", filename: "scene.glb", contents });
asset.on("error", (why) => {
    throw new Error(why);
});
asset.on("load", () => {
    const [vertex] = asset.resource.gsplats[0].resource.gsplatData.elements;
    writeFileSync(out, Buffer.concat(vertex.properties.map(({ storage }) => Buffer.from(storage.slice().buffer))));
    console.log(JSON.stringify(vertex.properties.map(({ name }) => name)));
    process.exit(0);
});
app.assets.add(asset);
app.assets.load(asset);
