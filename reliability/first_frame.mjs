// How long the page takes from its start to the first frame of a scene, in headless Chromium with a GPU in software (SwiftShader), and to
// the first frame of that GPU if one is asked for.
//
// GS3_NODE_MODULES=target/playwright node reliability/first_frame.mjs target/web FOLDER SCENE [BACKEND [WIDTH HEIGHT]]
//
// FOLDER has SCENE, a file of its own or the lod-meta.json of a streamed scene. BACKEND is auto, cpu or gpu.

import { createReadStream } from "node:fs";
import { stat } from "node:fs/promises";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import path from "node:path";

const [pageFolder, folder, scene, backend = "auto", width = "1280", height = "720"] = process.argv.slice(2);
if (!scene) throw new Error("expected PAGE, FOLDER and SCENE");
const { chromium } = createRequire(path.join(process.env.GS3_NODE_MODULES ?? process.cwd(), "x"))("playwright-core");
// The longest wait for anything, and how often the page is asked, in ms.
const [LONGEST, OFTEN] = [300_000, 50];

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".wasm": "application/wasm" };
const server = createServer(async (request, response) => {
  const { pathname } = new URL(request.url, "http://x");
  const file = pathname.startsWith("/scene/") ? path.join(folder, pathname.slice(7)) : path.join(pageFolder, pathname);
  const found = await stat(file).catch(() => undefined);
  if (!found?.isFile()) return response.writeHead(404).end();
  response.writeHead(200, { "Content-Type": TYPES[path.extname(file)] ?? "application/octet-stream", "Content-Length": found.size });
  createReadStream(file).pipe(response);
});
await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
const browser = await chromium.launch({
  executablePath: process.env.GS3_CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan"],
});
const page = await browser.newPage({ viewport: { width: Number(width), height: Number(height) } });
const begun = Date.now();
await page.goto(`http://127.0.0.1:${server.address().port}/index.html?backend=${backend}&url=${encodeURIComponent(`/scene/${scene}`)}`);

// Waits for the first frame at which the figures of the viewer, `f`, are so, and tells when.
async function tell(what, isSo) {
  await page.waitForFunction(`(() => {
    const f = window.viewer?.figures;
    if (f?.message) throw new Error(f.message);
    if (!f || !(${isSo})) return void (window.renderedBefore = f?.rendered ?? 0);
    return f.rendered > window.renderedBefore;
  })()`, undefined, { timeout: LONGEST, polling: OFTEN });
  const seconds = ((Date.now() - begun) / 1000).toFixed(1);
  const f = await page.evaluate(() => window.viewer.figures);
  console.log(`${what}: ${seconds} s; ${f.gaussians} Gaussians, ${f.width}×${f.height}, by the ${f.backend}`);
  return f;
}
// Before a scene is there, the page shows one Gaussian. A streamed scene has opened with its finest level.
const first = await tell("first frame", "!f.opening && f.gaussians > 1");
if (backend === "gpu" && first.backend === "cpu") await tell("first frame of the GPU", "f.backend === 'gpu'");
await browser.close();
server.close();
