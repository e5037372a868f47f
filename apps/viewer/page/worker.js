// The viewer's own thread: WebAssembly in, pictures out. gs3.js talks to it.

import { hasThreads } from "./built.js";

let viewer;
let timer;
// Messages of before the WebAssembly was there.
let early = [];
// Sources that wait to be opened, in order, by the name that the viewer asks for them with.
const sources = new Map();
const numbers = new Map();
// A picture that the page has not shown yet: no second one is made meanwhile.
let isShowing = false;
let shownAt = 0;
let wasIdle = false;
let isOver = false;

// Whether a step is under way: the viewer takes no calls then, and `waiting` has them.
let isStepping = false;
let waiting = [];

const figures = () => JSON.parse(viewer.figures());

// A trap of WebAssembly leaves no viewer to go on with.
function end(error) {
  if (isOver) return;
  isOver = true;
  const isMemory = error instanceof RangeError || /memory/i.test(String(error));
  const message = isMemory ? "the scene needs more memory than the browser gives a page" : `the viewer has failed: ${error?.message ?? error}`;
  postMessage({ kind: "end", message });
}

// Traps within a step: the promise of that step is never settled.
self.onerror = (message, source, line, column, error) => (end(error ?? message), true);
self.onunhandledrejection = (event) => (event.preventDefault(), end(event.reason));

// Does `work` with the viewer, after the step that is under way.
function guarded(work) {
  if (isOver) return;
  if (isStepping) return void waiting.push(work);
  try {
    work();
  } catch (error) {
    end(error);
  }
}

function schedule() {
  clearTimeout(timer);
  if (isShowing || isStepping || isOver) return;
  const wait = viewer.untilNext();
  if (wait < 0) {
    if (!wasIdle) postMessage({ kind: "idle", figures: figures() });
    wasIdle = true;
    return;
  }
  wasIdle = false;
  timer = setTimeout(() => guarded(step), wait);
}

async function step() {
  isStepping = true;
  const isNew = await viewer.step();
  isStepping = false;
  if (isNew) {
    const { width, height } = viewer;
    const pixels = viewer.rgba();
    isShowing = true;
    shownAt = performance.now();
    postMessage({ kind: "frame", width, height, pixels, figures: figures() }, [pixels.buffer]);
  }
  for (const effect of viewer.takeEffects()) {
    if (effect.kind === "open") open(effect.name);
    else if (effect.kind === "choose") postMessage({ kind: "choose" });
    else save(effect);
  }
  const work = waiting;
  waiting = [];
  work.forEach(guarded);
  schedule();
}

function save({ stem, extension, bytes }) {
  const number = (numbers.get(stem) ?? 0) + 1;
  numbers.set(stem, number);
  const name = `${stem}-${String(number).padStart(4, "0")}.${extension}`;
  postMessage({ kind: "save", name, bytes }, [bytes.buffer]);
  viewer.saved(name);
}

// The camera that the page begins with, once its scene is there.
let firstCamera;

// Number of the last opening.
let openings = 0;

// The value of `work` with the viewer, after the step that is under way.
const asked = (work) => new Promise((resolve, reject) => guarded(() => {
  try {
    resolve(work());
  } catch (error) {
    reject(error);
    throw error;
  }
}));

// Openings run side by side; the viewer ends those before a scene that is shown.
async function open(name) {
  const number = ++openings;
  const queue = sources.get(name) ?? [];
  const source = queue.shift();
  if (queue.length === 0) sources.delete(name);
  const progress = (share) => {
    guarded(() => viewer.progress(share));
    guarded(schedule);
  };
  let isBegun = false;
  try {
    const { files, base } = await read(source, progress);
    await asked(() => viewer.begin(number, name, files, base !== undefined));
    isBegun = true;
    for (let missing = []; missing !== undefined; ) {
      missing = await asked(() => viewer.goOn(number));
      if (!missing?.length) guarded(look);
      guarded(schedule);
      if (missing?.length) await supply(number, missing, base, progress);
    }
  } catch (error) {
    guarded(() => {
      if (!isBegun) viewer.begin(number, name, [], false);
      viewer.failed(number, `${name}: ${error.message ?? error}`);
    });
  }
  guarded(schedule);
}

// Files at a time: browsers open six connections to a server.
const CONNECTIONS = 6;

// Fetches the files at the paths `missing` beside `base`, and hands them to the viewer. The first that fails ends it.
async function supply(number, missing, base, progress) {
  let next = 0;
  let done = 0;
  const stop = new AbortController();
  const fetchSome = async () => {
    while (next < missing.length && !stop.signal.aborted) {
      const path = missing[next++];
      const url = new URL(path.split("/").map(encodeURIComponent).join("/"), base);
      try {
        const { bytes } = await fetched(url, () => {}, stop.signal);
        if (!(await asked(() => viewer.supply(number, path, bytes)))) stop.abort();
      } catch (error) {
        if (stop.signal.aborted) return;
        stop.abort();
        throw new Error(`${path}: ${error.message ?? error}`);
      }
      progress(++done / missing.length);
    }
  };
  await Promise.all(Array.from({ length: CONNECTIONS }, fetchSome));
}

// Moves the camera to where the page begins, once its scene is there.
function look() {
  if (firstCamera === undefined) return;
  const camera = firstCamera;
  firstCamera = undefined;
  try {
    viewer.setCamera(JSON.stringify(camera));
  } catch (error) {
    viewer.notChosen(error.message ?? String(error));
  }
}

// The `files` of a source, `[path, bytes]` each, and of a URL the `base` of what they name.
async function read(source, progress) {
  if (source === undefined || source.url === "demo") return { files: [] };
  if (source.files) {
    const files = [];
    for (const [path, file] of source.files) {
      files.push([path, new Uint8Array(await file.arrayBuffer())]);
      progress(files.length / source.files.length);
    }
    return { files };
  }
  // Servers may send elsewhere.
  const { bytes, url } = await fetched(source.url, progress);
  return { files: [[nameOf(source.url), bytes]], base: new URL(url, self.location.href) };
}

// The bytes at `url`, and where they were found.
async function fetched(url, progress, signal) {
  const response = await fetch(url, { signal });
  if (!response.ok) throw new Error(`expected a file, found ${response.status} ${response.statusText}`.trim());
  const length = Number(response.headers.get("content-length"));
  const reader = response.body.getReader();
  const parts = [];
  let count = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    parts.push(value);
    count += value.length;
    if (length > 0) progress(Math.min(1, count / length));
  }
  const bytes = new Uint8Array(count);
  let offset = 0;
  for (const part of parts) {
    bytes.set(part, offset);
    offset += part.length;
  }
  return { bytes, url: response.url };
}

function nameOf(url) {
  if (url === "demo") return url;
  const path = new URL(url, self.location.href).pathname;
  return decodeURIComponent(path.slice(path.lastIndexOf("/") + 1)) || path;
}

// What the page shows of several files is the name of their folder, or of the first of them.
function nameOfFiles(files) {
  const [path] = files[0];
  return files.length === 1 ? path : path.split("/")[0];
}

const answers = {
  camera: () => JSON.parse(viewer.camera()),
  setCamera: ({ camera }) => viewer.setCamera(JSON.stringify(camera)),
  setFps: ({ fps }) => viewer.setFps(fps),
  setPanels: ({ areShown }) => viewer.setPanels(areShown),
};

const inputs = {
  pointer: ({ x, y }) => viewer.pointerMoved(x, y),
  pointerGone: () => viewer.pointerGone(),
  button: ({ button, isPressed }) => viewer.button(button, isPressed),
  touch: ({ finger, name, x, y }) => viewer.touch(finger, name, x, y),
  wheel: ({ lines }) => viewer.wheel(lines),
  key: ({ key, isPressed }) => viewer.key(key, isPressed),
  modifiers: ({ shift, ctrl, alt }) => viewer.modifiers(shift, ctrl, alt),
  hovering: ({ isHovering }) => viewer.hovering(isHovering),
  focused: ({ isFocused }) => viewer.focused(isFocused),
  resized({ width, height, scale }) {
    viewer.resized(width, height);
    viewer.scale(scale);
  },
  shown() {
    isShowing = false;
    viewer.presented(performance.now() - shownAt);
  },
  notChosen: ({ message }) => viewer.notChosen(message),
  open(source) {
    if (source.files?.length === 0) return viewer.notChosen("expected a file, found none");
    let name;
    try {
      name = source.files ? nameOfFiles(source.files) : nameOf(source.url);
    } catch {
      return viewer.notChosen(`expected a URL, found "${source.url}"`);
    }
    sources.set(name, [...(sources.get(name) ?? []), source]);
    viewer.ask(name);
  },
};

// How long threads may take to start, in milliseconds: a worker that does not load tells nobody.
const LONGEST_START = 10_000;

// The WebAssembly of the viewer, and how many threads it has. Browsers let isolated pages alone share memory between threads.
async function load(threads) {
  if (hasThreads && threads > 1 && self.crossOriginIsolated) {
    try {
      const { default: init, initThreadPool, PageViewer, threadCount } = await import("./threads/gs3_viewer.js");
      await init({ module_or_path: new URL("./threads/gs3_viewer_bg.wasm", import.meta.url) });
      const late = new Promise((_, reject) => setTimeout(() => reject(new Error("threads do not start")), LONGEST_START));
      await Promise.race([initThreadPool(threads), late]);
      return { PageViewer, threads: threadCount() };
    } catch (error) {
      console.warn(`one thread: ${error.message ?? error}`);
    }
  }
  const { default: init, PageViewer } = await import("./gs3_viewer.js");
  await init({ module_or_path: new URL("./gs3_viewer_bg.wasm", import.meta.url) });
  return { PageViewer, threads: 1 };
}

async function begin({ settings, url, camera, noui, scale, threads: wanted }) {
  const { PageViewer, threads } = await load(wanted);
  viewer = await PageViewer.open(JSON.stringify(settings));
  viewer.scale(scale);
  if (noui) viewer.setPanels(false);
  firstCamera = camera;
  inputs.open({ url: url ?? "demo" });
  postMessage({ kind: "ready", backend: viewer.backend, threads });
}

function take(data) {
  if (data.number !== undefined) {
    try {
      postMessage({ kind: "answer", number: data.number, value: answers[data.kind](data) });
    } catch (error) {
      postMessage({ kind: "answer", number: data.number, error: error.message ?? String(error) });
    }
  } else {
    inputs[data.kind](data);
  }
}

self.onmessage = async ({ data }) => {
  if (data.kind === "begin") {
    try {
      await begin(data);
    } catch (error) {
      isOver = true;
      postMessage({ kind: "end", message: error.message ?? String(error) });
      return;
    }
    early.forEach((message) => guarded(() => take(message)));
    early = [];
    guarded(schedule);
  } else if (viewer === undefined) {
    early.push(data);
  } else {
    guarded(() => take(data));
    guarded(schedule);
  }
};
