// A hand at the page in a browser: real events of mouse, keyboard, wheel and touch. `page.rs` runs it and judges the pictures.
//
// node page.mjs PAGE SCENES OUT, where PAGE is the built page, SCENES has few.ply, part.ply, bad.ply, cameras.json, streamed/ and torn/, and OUT takes what was
// seen.

import assert from "node:assert/strict";
import { createReadStream } from "node:fs";
import { readFile, stat, writeFile } from "node:fs/promises";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import path from "node:path";

const [pageFolder, scenes, out] = process.argv.slice(2);
const { chromium } = createRequire(path.join(process.env.GS3_NODE_MODULES ?? process.cwd(), "x"))("playwright-core");

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".wasm": "application/wasm" };
const HOST = `<!doctype html><title>host</title><iframe src="/index.html?noui" width="320" height="200"></iframe>
<script>window.told = []; addEventListener("message", ({ data }) => told.push(data));</script>`;

// What the worker runs first: it keeps the devices that are opened, so that one can be lost.
const KEEP_DEVICES = `const request = GPUAdapter.prototype.requestDevice;
GPUAdapter.prototype.requestDevice = async function (...wishes) {
  self.device = await request.apply(this, wishes);
  return self.device;
};`;
// The GPU of this browser is one in software, which only who asks for it gets; with this the page does not see that.
const AS_HARDWARE = `Object.defineProperty(GPUAdapterInfo.prototype, "isFallbackAdapter", { get: () => false });`;
let isAsHardware = false;
// What lets a page share memory between threads.
const ISOLATED = { "Cross-Origin-Opener-Policy": "same-origin", "Cross-Origin-Embedder-Policy": "require-corp" };
let isIsolated = false;
// The finer level of the streamed scene is held back until this is called.
let letFineOne;
const fineOne = new Promise((resolve) => (letFineOne = resolve));

const server = createServer(async (request, response) => {
  const { pathname } = new URL(request.url, "http://x");
  if (pathname === "/host.html") return response.writeHead(200, { "Content-Type": "text/html" }).end(HOST);
  const file = pathname.startsWith("/scenes/") ? path.join(scenes, pathname.slice(8)) : path.join(pageFolder, pathname);
  if (!(await stat(file).catch(() => undefined))?.isFile()) return response.writeHead(404).end();
  if (pathname === "/worker.js") {
    const worker = await readFile(file, "utf8");
    return response.writeHead(200, { "Content-Type": TYPES[".js"], ...(isIsolated && ISOLATED) }).end(KEEP_DEVICES + (isAsHardware ? AS_HARDWARE : "") + worker);
  }
  if (pathname.endsWith("/fine.sog")) await fineOne;
  const { size } = await stat(file);
  response.writeHead(200, { "Content-Type": TYPES[path.extname(file)] ?? "application/octet-stream", "Content-Length": size, ...(isIsolated && ISOLATED) });
  createReadStream(file).pipe(response);
});
await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
const base = `http://127.0.0.1:${server.address().port}`;

const browser = await chromium.launch({
  executablePath: process.env.GS3_CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan"],
});
const context = await browser.newContext({ viewport: { width: 400, height: 240 }, hasTouch: true, acceptDownloads: true });
const failures = [];

async function opened(query = "", size = { width: 400, height: 240 }) {
  const page = await context.newPage();
  await page.setViewportSize(size);
  page.on("pageerror", (error) => failures.push(`page error: ${error.message}`));
  page.on("console", (message) => message.type() === "error" && console.log(`console: ${message.text()}`));
  await page.goto(`${base}/index.html${query}`);
  return page;
}

const figures = (page) => page.evaluate(() => window.viewer.figures);
const camera = (page) => page.evaluate(() => window.viewer.camera());
// Until what the viewer says of itself is so.
async function until(page, what, told, seconds = 300) {
  const body = `(() => { const f = window.viewer?.figures; return f !== undefined && (${told}); })()`;
  await page.waitForFunction(body, undefined, { timeout: seconds * 1e3, polling: 50 }).catch(async () => {
    const actual = await page.evaluate(() => JSON.stringify(window.viewer?.figures));
    throw new Error(`expected ${what}, found ${actual}`);
  });
}
const atRest = (page) => until(page, "rest at the native image", "f.idle && f.native && !f.opening");
const canvasOf = async (page) => Buffer.from((await page.evaluate(() => document.getElementById("canvas").toDataURL("image/png"))).split(",")[1], "base64");

async function check(name, work) {
  const started = performance.now();
  try {
    await work();
    console.log(`ok ${name} (${((performance.now() - started) / 1e3).toFixed(1)} s)`);
  } catch (error) {
    failures.push(`${name}: ${error.message}`);
    console.log(`not ok ${name}: ${error.message}`);
  }
}

let page;
await check("the built-in scene comes to rest at the native image, and no more frames are made", async () => {
  page = await opened("?noui");
  await atRest(page);
  const before = await figures(page);
  assert.ok(before.gaussians > 100_000 && before.backend === "cpu");
  await page.waitForTimeout(500);
  const after = await figures(page);
  assert.equal(after.rendered, before.rendered);
  // A note that ends is painted once more.
  assert.ok(after.displayed <= before.displayed + 1, `${after.displayed} after ${before.displayed}`);
  await writeFile(path.join(out, "demo.png"), await canvasOf(page));
  await writeFile(path.join(out, "demo.json"), JSON.stringify(await camera(page)));
});
const firstCamera = await camera(page);

// On any number of threads a frame has the same bits.
const { hasThreads } = await import(`data:text/javascript,${encodeURIComponent(await readFile(path.join(pageFolder, "built.js"), "utf8"))}`);
if (!hasThreads) console.log("skipped: a page built with --threads");
else await check("an isolated page renders the same image on all threads that it is given", async () => {
  isIsolated = true;
  try {
    const onThreads = await opened("?noui&threads=3");
    await atRest(onThreads);
    assert.equal(await onThreads.evaluate(() => window.viewer.threads), 3);
    assert.ok((await canvasOf(onThreads)).equals(await readFile(path.join(out, "demo.png"))));
    await onThreads.close();
  } finally {
    isIsolated = false;
  }
  assert.equal(await page.evaluate(() => window.viewer.threads), 1);
});

await check("drags orbit and pan, the wheel comes closer, keys fly, a double click sets the pivot", async () => {
  const places = [await camera(page)];
  const moved = async (what, hand) => {
    const frames = (await figures(page)).rendered;
    await hand();
    await until(page, `frames after ${what}`, `f.rendered > ${frames}`);
    await atRest(page);
    const now = await camera(page);
    assert.notDeepEqual(now, places.at(-1), what);
    places.push(now);
  };
  const drag = async (button) => {
    await page.mouse.move(200, 120);
    await page.mouse.down({ button });
    await page.mouse.move(230, 130, { steps: 4 });
    await page.mouse.up({ button });
  };
  await moved("a left drag", () => drag("left"));
  await moved("a right drag", () => drag("right"));
  const length = ({ position, target }) => Math.hypot(...position.map((v, k) => v - target[k]));
  await moved("the wheel", () => page.mouse.wheel(0, -120));
  assert.ok(length(places.at(-1)) < length(places.at(-2)));
  await moved("W", async () => {
    await page.keyboard.down("w");
    await page.waitForTimeout(400);
    await page.keyboard.up("w");
  });
  const before = await camera(page);
  await page.mouse.dblclick(200, 120);
  await page.waitForTimeout(300);
  assert.notDeepEqual((await camera(page)).target, before.target);
  await writeFile(path.join(out, "moved.png"), await canvasOf(page));
  await writeFile(path.join(out, "moved.json"), JSON.stringify(await camera(page)));
});

await check("fingers orbit, and two of them pinch", async () => {
  const touch = await context.newCDPSession(page);
  const send = (type, points) => touch.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  const before = await camera(page);
  await send("touchStart", [[150, 120]]);
  await send("touchMove", [[180, 120]]);
  await send("touchEnd", []);
  await page.waitForTimeout(300);
  await atRest(page);
  const turned = await camera(page);
  assert.notDeepEqual(turned.position, before.position);
  await send("touchStart", [[150, 120]]);
  await send("touchStart", [[150, 120], [250, 120]]);
  await send("touchMove", [[120, 120], [280, 120]]);
  await send("touchEnd", []);
  await page.waitForTimeout(300);
  await atRest(page);
  const length = ({ position, target }) => Math.hypot(...position.map((v, k) => v - target[k]));
  const ratio = length(await camera(page)) / length(turned);
  assert.ok(Math.abs(ratio - 100 / 160) < 0.02, `the pinch scales the distance by ${ratio}`);
});

await check("the split screen, keyframes and their path, a screenshot and their files", async () => {
  await page.evaluate(() => {
    window.saved = [];
    window.viewer.addEventListener("save", (event) => {
      event.preventDefault();
      saved.push({ name: event.detail.name, bytes: Array.from(event.detail.bytes) });
    });
  });
  // Where flying ended depends on the pace of frames, and so does what is in view; the split screen is judged from a known place.
  await page.evaluate((camera) => viewer.setCamera(camera), firstCamera);
  await page.waitForTimeout(300);
  await atRest(page);
  // The first bicubic frame takes its time: until there are frames, the page is at rest as before.
  const before = (await figures(page)).rendered;
  await page.keyboard.press("c");
  await page.keyboard.press("c");
  await until(page, "frames of the split screen", `f.rendered > ${before} + 1`);
  await atRest(page);
  await writeFile(path.join(out, "split.png"), await canvasOf(page));
  await writeFile(path.join(out, "split.json"), JSON.stringify(await camera(page)));
  for (let k = 0; k < 3; k++) await page.keyboard.press("c");
  await page.keyboard.press("k");
  await page.mouse.wheel(0, -240);
  await page.waitForTimeout(300);
  await atRest(page);
  await page.keyboard.press("k");
  await page.keyboard.press("p");
  await page.waitForFunction(() => window.saved.length === 1, undefined, { timeout: 300_000 });
  const [shot] = await page.evaluate(() => window.saved);
  assert.equal(shot.name, "gs3-0001.png");
  await writeFile(path.join(out, "shot.png"), Buffer.from(shot.bytes));
  await writeFile(path.join(out, "shot.json"), JSON.stringify(await camera(page)));
  const atKey = await camera(page);
  await page.keyboard.press(" ");
  await page.waitForTimeout(800);
  assert.notDeepEqual(await camera(page), atKey);
  await until(page, "rest after the path", "f.idle && f.native");
});

const drop = (name) => page.evaluate(async (name) => {
  const bytes = await (await fetch(`/scenes/${name}`)).arrayBuffer();
  const transfer = new DataTransfer();
  transfer.items.add(new File([bytes], name));
  const canvas = document.getElementById("canvas");
  for (const kind of ["dragover", "drop"]) canvas.dispatchEvent(new DragEvent(kind, { dataTransfer: transfer, bubbles: true, cancelable: true }));
}, name);

await check("a dropped scene is shown; a bad one is told and leaves the scene", async () => {
  await drop("few.ply");
  await until(page, "three Gaussians", "f.gaussians === 3 && f.scene === 'few.ply'");
  await atRest(page);
  await drop("bad.ply");
  await until(page, "a message", "typeof f.message === 'string'");
  const { message, gaussians } = await figures(page);
  assert.match(message, /^bad\.ply: /);
  assert.equal(gaussians, 3);
});

await check("O asks for files; several may be chosen; a page may ask in its own way", async () => {
  const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.keyboard.press("o")]);
  assert.ok(chooser.isMultiple());
  await chooser.setFiles([path.join(scenes, "few.ply"), path.join(scenes, "cameras.json")]);
  await until(page, "the scene and its cameras", "f.gaussians === 3 && f.message === null && !f.opening");
  await atRest(page);
  const before = await camera(page);
  await page.keyboard.press(" ");
  await page.waitForTimeout(500);
  assert.notDeepEqual(await camera(page), before);
  await until(page, "rest after the path", "f.idle && f.native");
  const asked = await page.evaluate(() => new Promise((resolve) => {
    window.viewer.addEventListener("choose", (event) => (event.preventDefault(), resolve(true)), { once: true });
    window.viewer.press("o");
  }));
  assert.equal(asked, true);
});

await check("the window is resized", async () => {
  await page.setViewportSize({ width: 300, height: 180 });
  await until(page, "a picture of the new size", "f.width === 300 && f.height === 180");
  await atRest(page);
  const size = await page.evaluate(() => [document.getElementById("canvas").width, document.getElementById("canvas").height]);
  assert.deepEqual(size, [300, 180]);
  await page.close();
});

await check("?url= and #camera= are shown; the address keeps the view", async () => {
  const place = { position: [0, -1, -6], target: [0.5, 0, 0], fov: 40 };
  const linked = await opened(`?url=/scenes/few.ply&quality=high#camera=${encodeURIComponent(JSON.stringify(place))}`);
  await until(linked, "the scene", "f.gaussians === 3");
  await atRest(linked);
  const now = await camera(linked);
  for (const key of ["position", "target"]) now[key].forEach((v, k) => assert.ok(Math.abs(v - place[key][k]) < 1e-6));
  await linked.waitForFunction(() => location.hash.includes("camera"));
  await writeFile(path.join(out, "panels.png"), await linked.screenshot());
  await linked.close();
});

// SwiftShader takes a millisecond for each workgroup with barriers: few Gaussians, and few pixels.
const SMALL = { width: 200, height: 120 };
const drag = async (page) => {
  const { rendered } = await figures(page);
  // Away from the divider of a split screen.
  await page.mouse.move(50, 60);
  await page.mouse.down();
  await page.mouse.move(70, 70, { steps: 4 });
  await page.mouse.up();
  await until(page, "frames after a drag", `f.rendered > ${rendered} || typeof f.message === "string"`);
};
const loseDevice = (page) => page.workers()[0].evaluate(() => self.device.destroy());

await check("a GPU renders: rest at the native image, a drag, a pivot, a split screen; once it is lost, a message says so", async () => {
  const gpu = await opened("?backend=gpu&noui&url=/scenes/part.ply", SMALL);
  await until(gpu, "frames of the CPU before", "f.backend === 'cpu' && f.gaussians > 3 && f.rendered > 0");
  await atRest(gpu);
  assert.equal((await figures(gpu)).backend, "gpu");
  await drag(gpu);
  await atRest(gpu);
  const before = await camera(gpu);
  await gpu.mouse.dblclick(100, 60);
  await gpu.waitForTimeout(500);
  assert.notDeepEqual((await camera(gpu)).target, before.target);
  await writeFile(path.join(out, "gpu.png"), await canvasOf(gpu));
  await writeFile(path.join(out, "gpu.json"), JSON.stringify(await camera(gpu)));
  const { rendered } = await figures(gpu);
  await gpu.keyboard.press("c");
  await gpu.keyboard.press("c");
  await until(gpu, "frames of the split screen", `f.rendered > ${rendered} + 1`);
  await atRest(gpu);
  await writeFile(path.join(out, "gpu-split.png"), await canvasOf(gpu));
  await writeFile(path.join(out, "gpu-split.json"), JSON.stringify(await camera(gpu)));
  await loseDevice(gpu);
  await drag(gpu);
  await until(gpu, "a message", "typeof f.message === 'string'");
  assert.match((await figures(gpu)).message, /^GPU.*lost/);
  await gpu.close();
});

await check("the CPU goes on where a GPU is lost before it is ready, and a message says so", async () => {
  const early = await opened("?backend=gpu&noui&url=/scenes/part.ply", SMALL);
  await until(early, "frames of the CPU", "f.backend === 'cpu' && f.gaussians > 3 && f.rendered > 0");
  await loseDevice(early);
  await until(early, "a message", "typeof f.message === 'string'");
  const { message, backend } = await figures(early);
  // The answer that the warm-up waits for may fail before the loss is told.
  assert.match(message, /^GPU.*; the CPU renders$/);
  assert.equal(backend, "cpu");
  await early.close();
});

await check("a GPU in software is not taken unasked; the CPU takes over from one that is lost", async () => {
  isAsHardware = true;
  const auto = await opened("?noui&url=/scenes/part.ply", SMALL);
  await until(auto, "frames of a GPU", "f.backend === 'gpu' && f.gaussians > 3 && f.rendered > 0");
  isAsHardware = false;
  await loseDevice(auto);
  await drag(auto);
  await until(auto, "frames of the CPU", "f.backend === 'cpu' && f.message === null");
  await atRest(auto);
  await writeFile(path.join(out, "taken-over.png"), await canvasOf(auto));
  await writeFile(path.join(out, "taken-over.json"), JSON.stringify(await camera(auto)));
  await auto.close();
});

await check("a streamed scene is coarse first, then fine, where the camera is; a budget holds it back", async () => {
  const place = { position: [4, -1, -6], target: [4, 0, 0], fov: 60 };
  const streamed = await opened(`?noui&url=/scenes/streamed/lod-meta.json#camera=${encodeURIComponent(JSON.stringify(place))}`);
  await until(streamed, "the coarse level", "f.gaussians === 3 && f.opening");
  // A file that is none leaves the opening of the scene as it is.
  await streamed.evaluate(() => viewer.open("/scenes/none.ply"));
  await until(streamed, "a message", "typeof f.message === 'string'");
  letFineOne();
  await until(streamed, "the finest level", "f.gaussians === 9 && !f.opening");
  await atRest(streamed);
  const { position } = await camera(streamed);
  position.forEach((v, k) => assert.ok(Math.abs(v - place.position[k]) < 1e-6));
  await streamed.close();
  const held = await opened("?noui&budget=5&url=/scenes/streamed/lod-meta.json");
  await until(held, "the coarse level", "f.gaussians === 3 && !f.opening");
  await held.close();
  const torn = await opened("?noui&url=/scenes/torn/lod-meta.json");
  await until(torn, "a message", "typeof f.message === 'string'");
  assert.match((await figures(torn)).message, /^lod-meta.json: none.sog: expected a file, found 404/);
  await torn.close();
});

await check("what cannot be is told in one line", async () => {
  const missing = await opened("?url=/scenes/none.ply");
  await until(missing, "a message", "typeof f.message === 'string'");
  assert.match((await figures(missing)).message, /^none\.ply: expected a file, found 404/);
  await missing.close();
  for (const [query, expected] of [
    ["?speed=3", "?speed: expected one of url, quality, backend, fps, maxPixels, budget, threads, noui, found speed"],
    ["?fps=fast", 'fps: expected a number, found "fast"'],
    ["?backend=cuda", 'settings: backend: expected auto, cpu or gpu, found "cuda"'],
    ["?quality=best", 'settings: quality: expected fast, balanced or high, found "best"'],
  ]) {
    const refused = await opened(query);
    await refused.waitForSelector("#message.shown");
    assert.equal(await refused.textContent("#message"), expected);
    await refused.close();
  }
});

await check("a page around it talks with it", async () => {
  const host = await context.newPage();
  await host.goto(`${base}/host.html`);
  const told = (type, seconds = 300) => host.waitForFunction((type) => window.told.find((data) => data.type === type), type, { timeout: seconds * 1e3 }).then((found) => found.jsonValue());
  const ask = (message) => host.evaluate((message) => document.querySelector("iframe").contentWindow.postMessage(message, "*"), message);
  await told("gs3:ready");
  await ask({ type: "gs3:open", url: "/scenes/few.ply" });
  await host.waitForFunction(() => window.told.some((data) => data.type === "gs3:idle" && data.figures.gaussians === 3), undefined, { timeout: 300_000 });
  await ask({ type: "gs3:camera", camera: { position: [0, 0, -5], target: [0, 0, 0], fov: 30 }, id: 7 });
  const done = await told("gs3:camera:done");
  assert.deepEqual([done.id, done.error], [7, undefined]);
  await host.evaluate(() => (window.told = []));
  await ask({ type: "gs3:camera", camera: { position: [0, 0, 0], target: [0, 0, 0] } });
  assert.match((await told("gs3:camera:done")).error, /expected a position and a target elsewhere/);
  await host.close();
});

await browser.close();
server.close();
const weight = (await readFile(path.join(pageFolder, "gs3_viewer_bg.wasm"))).length;
console.log(`the WebAssembly has ${(weight / 1e6).toFixed(2)} MB`);
if (failures.length > 0) {
  console.log(failures.join("\n"));
  process.exit(1);
}
