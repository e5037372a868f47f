// index.html: a viewer as large as the window, told what to show by its URL and by messages of the page around it.
//
// ?url=SCENE &quality=fast|balanced|high &backend=auto|gpu|cpu &fps=N &maxPixels=N &budget=N &threads=N &noui   and   #camera={"position":…,"target":…,"fov":…}

import { createViewer } from "./gs3.js";

const canvas = document.getElementById("canvas");
const text = document.getElementById("message");
const parameters = new URLSearchParams(location.search);
// The page around an iframe; nobody where there is none.
const tell = (message) => window.parent !== window && window.parent.postMessage(message, "*");

function show(message) {
  text.textContent = message;
  text.classList.add("shown");
  tell({ type: "gs3:error", message });
}

function number(name) {
  const value = parameters.get(name);
  if (value === null) return {};
  if (value.trim() === "" || !Number.isFinite(Number(value))) throw new Error(`${name}: expected a number, found "${value}"`);
  return { [name]: Number(value) };
}

function cameraOf(hash) {
  const value = new URLSearchParams(hash.slice(1)).get("camera");
  if (value === null) return undefined;
  try {
    return JSON.parse(value);
  } catch {
    throw new Error(`#camera: expected JSON with position and target, found "${value}"`);
  }
}

function options() {
  const known = ["url", "quality", "backend", "fps", "maxPixels", "budget", "threads", "noui"];
  for (const name of parameters.keys()) {
    if (!known.includes(name)) throw new Error(`?${name}: expected one of ${known.join(", ")}, found ${name}`);
  }
  const named = ["url", "quality", "backend"].filter((name) => parameters.has(name)).map((name) => [name, parameters.get(name)]);
  return {
    ...Object.fromEntries(named), ...number("fps"), ...number("maxPixels"), ...number("budget"), ...number("threads"),
    noui: parameters.has("noui"), camera: cameraOf(location.hash),
  };
}

async function begin() {
  const viewer = await createViewer(canvas, options());
  // For the console of a browser, and for tests.
  window.viewer = viewer;
  viewer.addEventListener("error", ({ detail }) => show(detail.message));
  viewer.addEventListener("idle", async ({ detail }) => {
    tell({ type: "gs3:idle", figures: detail });
    // The address names the view, so that it can be kept and sent on.
    const camera = JSON.stringify(await viewer.camera());
    history.replaceState(null, "", `#${new URLSearchParams({ camera })}`);
  });
  window.addEventListener("hashchange", () => {
    Promise.resolve().then(() => cameraOf(location.hash)).then((camera) => camera && viewer.setCamera(camera)).catch((error) => console.warn(error.message));
  });
  const wishes = {
    "gs3:open": ({ url, file }) => viewer.open(file ?? url),
    "gs3:camera": ({ camera }) => (camera ? viewer.setCamera(camera) : viewer.camera()),
    "gs3:figures": () => viewer.figures,
    "gs3:press": ({ key }) => viewer.press(key),
    "gs3:panels": ({ shown }) => viewer.setPanels(shown),
    "gs3:fps": ({ fps }) => viewer.setFps(fps),
  };
  window.addEventListener("message", async ({ data, source }) => {
    const wish = wishes[data?.type];
    if (wish === undefined) return;
    const answer = { type: `${data.type}:done`, id: data.id };
    try {
      answer.value = await wish(data);
    } catch (error) {
      answer.error = error.message;
    }
    source?.postMessage(answer, "*");
  });
  canvas.focus();
  tell({ type: "gs3:ready" });
}

begin().catch((error) => show(error.message));
