// gs3 in a web page: `createViewer(canvas, options)`. Types and all options: gs3.d.ts.

const WORKER = new URL("./worker.js", import.meta.url);
// Pixels at rates fit for moving a camera; larger canvases are stretched. `cpu`: what each thread of a browser rasterizes. `gpu`:
// what one thread reads back from a GPU, and what a browser shows of the CPU's pictures.
const MOST_PIXELS = { cpu: 640 * 360, gpu: 1280 * 720 };
// Pixels of a touch pad that count as a line of a wheel, and lines of a page.
const WHEEL_LINE = { 0: 1 / 40, 1: 1, 2: 20 };

/** Shows scenes in `canvas`. Resolves once the viewer runs; rejects with one line where it cannot. */
export async function createViewer(canvas, options = {}) {
  const { url, camera, noui = false, maxPixels, threads = navigator.hardwareConcurrency ?? 1, ...settings } = options;
  if (!(canvas instanceof HTMLCanvasElement)) throw new TypeError(`canvas: expected a canvas element, found ${canvas}`);
  if (typeof WebAssembly !== "object") throw new Error("WebAssembly: expected a browser that has it, found none");
  if (maxPixels !== undefined && !(maxPixels >= 64)) throw new TypeError(`maxPixels: expected 64 or more, found ${maxPixels}`);
  if (!(Number.isInteger(threads) && threads >= 1)) throw new TypeError(`threads: expected 1 or more, found ${threads}`);
  const worker = new Worker(WORKER, { type: "module" });
  const viewer = new PageViewer(canvas, worker, maxPixels);
  await viewer.start(settings, { url, camera, noui, threads });
  return viewer;
}

class PageViewer extends EventTarget {
  #canvas;
  #context;
  #worker;
  #maxPixels;
  #isSizeAsked;
  #backend;
  #threads = 1;
  #asked = new Map();
  #asks = 0;
  #ready;
  #stop = new AbortController();
  #resizes;
  // The picture is smaller than the canvas by this factor.
  #ratio = 1;
  #figures = {};

  constructor(canvas, worker, maxPixels) {
    super();
    [this.#canvas, this.#worker, this.#maxPixels] = [canvas, worker, maxPixels ?? MOST_PIXELS.cpu];
    this.#isSizeAsked = maxPixels !== undefined;
    this.#context = canvas.getContext("2d", { alpha: false });
  }

  start(settings, beginning) {
    const started = new Promise((resolve, reject) => (this.#ready = { resolve, reject }));
    this.#worker.onmessage = ({ data }) => this.#take(data);
    this.#worker.onerror = (event) => this.#end(event.message || "the worker does not start");
    const [width, height] = this.#size();
    this.#worker.postMessage({ kind: "begin", settings: { width, height, ...settings }, ...beginning, scale: this.#scale() });
    this.#listen();
    return started;
  }

  /** Opens the scene or the cameras at `source`: a URL, "demo", a File, or a list of Files: a folder's, or a scene and its cameras. */
  open(source) {
    const files = source instanceof Blob ? [source] : source;
    const message = typeof source === "string" ? { url: source } : { files: Array.from(files, (file) => [pathOf(file), file]) };
    this.#worker.postMessage({ kind: "open", ...message });
  }

  /** The camera: `{position, target, fov}`. */
  camera() {
    return this.#ask({ kind: "camera" });
  }

  /** Moves the camera. Rejects with one line if it is none. */
  setCamera(camera) {
    return this.#ask({ kind: "setCamera", camera });
  }

  /** Displayed frames a second to aim at. */
  setFps(fps) {
    return this.#ask({ kind: "setFps", fps });
  }

  /** Whether panels lie over the picture. */
  setPanels(areShown) {
    return this.#ask({ kind: "setPanels", areShown });
  }

  /** Presses and releases a key, as `KeyboardEvent.key` names it. */
  press(key) {
    for (const isPressed of [true, false]) this.#worker.postMessage({ kind: "key", key, isPressed });
  }

  /** Threads of the CPU that render. */
  get threads() {
    return this.#threads;
  }

  /** Figures of the frames displayed last. */
  get figures() {
    return this.#figures;
  }

  /** Ends the viewer and its worker. */
  destroy() {
    this.#stop.abort();
    this.#resizes?.disconnect();
    this.#worker.terminate();
    for (const { reject } of this.#asked.values()) reject(new Error("the viewer is closed"));
    this.#asked.clear();
  }

  #ask(message) {
    const number = ++this.#asks;
    this.#worker.postMessage({ ...message, number });
    return new Promise((resolve, reject) => this.#asked.set(number, { resolve, reject }));
  }

  #end(message) {
    this.#ready.reject(new Error(message));
    this.#emit("error", { message });
    this.destroy();
  }

  #emit(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  #take(data) {
    switch (data.kind) {
      case "ready":
        this.#threads = data.threads;
        this.#rendersOn(data.backend);
        return this.#ready.resolve();
      case "end":
        return this.#end(data.message);
      case "answer": {
        const asked = this.#asked.get(data.number);
        this.#asked.delete(data.number);
        return data.error === undefined ? asked?.resolve(data.value) : asked?.reject(new Error(data.error));
      }
      case "frame": {
        const { width, height, pixels } = data;
        if (this.#canvas.width !== width) this.#canvas.width = width;
        if (this.#canvas.height !== height) this.#canvas.height = height;
        this.#context.putImageData(new ImageData(pixels, width, height), 0, 0);
        this.#figures = data.figures;
        this.#rendersOn(data.figures.backend);
        this.#worker.postMessage({ kind: "shown" });
        return this.#emit("frame", data.figures);
      }
      case "idle":
        this.#figures = data.figures;
        return this.#emit("idle", data.figures);
      case "save":
        return this.#save(data);
      case "choose":
        return this.#choose();
    }
  }

  // The button and the key that ask for files. A page may ask in its own way: `event.preventDefault()`, then `open`.
  #choose() {
    if (!this.dispatchEvent(new CustomEvent("choose", { cancelable: true }))) return;
    const input = document.createElement("input");
    [input.type, input.multiple, input.hidden] = ["file", true, true];
    const post = (message) => this.#worker.postMessage(message);
    input.addEventListener("change", () => {
      if (input.files.length > 0) this.open(input.files);
      input.remove();
    });
    input.addEventListener("cancel", () => input.remove());
    document.body.append(input);
    try {
      // Browsers let a page ask for files for some seconds after a click or a key.
      input.showPicker();
    } catch (error) {
      input.remove();
      post({ kind: "notChosen", message: `file dialog: expected one after a click or a key, found ${error.message}` });
    }
  }

  // A page may stop a save and take the bytes itself: `event.preventDefault()`.
  #save({ name, bytes }) {
    const event = new CustomEvent("save", { detail: { name, bytes }, cancelable: true });
    if (this.dispatchEvent(event)) {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([bytes]));
      link.download = name;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
    }
  }

  #size() {
    const rect = this.#canvas.getBoundingClientRect();
    const dense = window.devicePixelRatio || 1;
    const wanted = [rect.width * dense, rect.height * dense].map((side) => Math.max(1, side));
    const shrink = Math.min(1, Math.sqrt(this.#maxPixels / (wanted[0] * wanted[1])));
    const size = wanted.map((side) => Math.max(1, Math.round(side * shrink)));
    this.#ratio = size[0] / Math.max(1, rect.width);
    return size;
  }

  // Panels keep their size on the screen, as far as their text can be read in so few pixels.
  #scale() {
    return Math.max(0.75, this.#ratio);
  }

  #listen() {
    const canvas = this.#canvas;
    const post = (message) => this.#worker.postMessage(message);
    const on = (target, name, handler, more = {}) =>
      target.addEventListener(name, handler, { signal: this.#stop.signal, ...more });
    const at = (event) => {
      const rect = canvas.getBoundingClientRect();
      return [(event.clientX - rect.left) * this.#ratio, (event.clientY - rect.top) * this.#ratio];
    };
    const held = (event) => post({ kind: "modifiers", shift: event.shiftKey, ctrl: event.ctrlKey, alt: event.altKey });
    canvas.tabIndex = 0;
    canvas.style.touchAction = "none";
    for (const name of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) {
      on(canvas, name, (event) => {
        const [x, y] = at(event);
        if (name === "pointerdown") {
          canvas.focus({ preventScroll: true });
          // Synthetic pointers have nothing to capture.
          try { canvas.setPointerCapture(event.pointerId); } catch {}
        }
        held(event);
        if (event.pointerType === "touch") return post({ kind: "touch", finger: event.pointerId, name, x, y });
        post({ kind: "pointer", x, y });
        if (name !== "pointermove") post({ kind: "button", button: event.button, isPressed: name === "pointerdown" });
      });
    }
    on(canvas, "pointerleave", (event) => event.pointerType !== "touch" && post({ kind: "pointerGone" }));
    on(canvas, "contextmenu", (event) => event.preventDefault());
    on(canvas, "wheel", (event) => {
      event.preventDefault();
      post({ kind: "wheel", lines: -event.deltaY * WHEEL_LINE[event.deltaMode] });
    }, { passive: false });
    for (const name of ["keydown", "keyup"]) {
      on(canvas, name, (event) => {
        held(event);
        if (event.repeat || event.metaKey || (event.ctrlKey && event.key.length > 1)) return;
        // Space and Backspace are the viewer's here, not the page's.
        if ([" ", "Backspace"].includes(event.key)) event.preventDefault();
        // The browser's own dialog would leave the page.
        if (event.ctrlKey && event.key === "o") event.preventDefault();
        post({ kind: "key", key: event.key, isPressed: name === "keydown" });
      });
    }
    on(canvas, "focus", () => post({ kind: "focused", isFocused: true }));
    on(canvas, "blur", () => post({ kind: "focused", isFocused: false }));
    on(canvas, "dragover", (event) => {
      event.preventDefault();
      post({ kind: "hovering", isHovering: true });
    });
    on(canvas, "dragleave", () => post({ kind: "hovering", isHovering: false }));
    on(canvas, "drop", async (event) => {
      event.preventDefault();
      post({ kind: "hovering", isHovering: false });
      const files = await filesOf(event.dataTransfer);
      if (files.length > 0) post({ kind: "open", files });
    });
    this.#resizes = new ResizeObserver(() => this.#resize());
    this.#resizes.observe(canvas);
  }

  // The machine may change: a GPU goes on once it is ready, and the CPU once a GPU is lost.
  #rendersOn(backend) {
    if (backend === this.#backend) return;
    this.#backend = backend;
    if (!this.#isSizeAsked) this.#maxPixels = Math.min(MOST_PIXELS.gpu, MOST_PIXELS[backend] * this.#threads);
    this.#resize();
  }

  #resize() {
    const [width, height] = this.#size();
    this.#worker.postMessage({ kind: "resized", width, height, scale: this.#scale() });
  }
}

const pathOf = (file) => file.webkitRelativePath || file.name || "scene";

/** The files of a drop, those of folders too: `[path, File]`. */
async function filesOf(transfer) {
  const entries = Array.from(transfer.items ?? [], (item) => item.webkitGetAsEntry?.()).filter((entry) => entry);
  if (entries.length === 0) return Array.from(transfer.files, (file) => [pathOf(file), file]);
  const found = [];
  const visit = async (entry) => {
    if (entry.isFile) {
      const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
      found.push([entry.fullPath.replace(/^\//, ""), file]);
      return;
    }
    const reader = entry.createReader();
    // A reader gives some entries at a time, and none at the end.
    for (;;) {
      const some = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
      if (some.length === 0) return;
      for (const inner of some) await visit(inner);
    }
  };
  for (const entry of entries) await visit(entry);
  return found;
}
