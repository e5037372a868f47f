/** A camera in the coordinates of the scene's file. */
export interface Camera {
  /** Where the camera is. */
  position: [number, number, number];
  /** The point in the middle of the picture that the camera turns around. */
  target: [number, number, number];
  /** Vertical field of view, degrees, 5 to 120. Missing: as before. */
  fov?: number;
}

export interface ViewerOptions {
  /** A scene: a URL that the page may fetch, or "demo", the built-in scene and the default. */
  url?: string;
  /** The first camera. Missing: the scene's own, or one that has all of the scene in view. */
  camera?: Camera;
  /** Exact pixels by the error that may be seen. Missing: as many as the frame rate leaves time for. */
  quality?: "fast" | "balanced" | "high";
  /** Displayed frames a second to aim at, 1 to 1000; 30. */
  fps?: number;
  /** High-resolution over low-resolution size, 1 to 8. Missing: 4 up to 2560×1440 pixels, 6 above. */
  scale?: number;
  /** The machine that renders; "auto", the default, is a GPU that the browser offers, if it is none in software. */
  backend?: "auto" | "gpu" | "cpu";
  /** Gaussians of a streamed scene at most, at the levels that leave the least error. Missing: its finest levels. */
  budget?: number;
  /** Threads of the CPU; all of its cores. One where the page is not isolated from others, or was built for one. */
  threads?: number;
  /** No panels over the picture. */
  noui?: boolean;
  /**
   * Pixels of the picture at most; larger canvases stretch the picture. 230400 (640×360) for each thread of the CPU up to 921600,
   * 921600 (1280×720) on a GPU.
   */
  maxPixels?: number;
}

/** Figures of the frames displayed last. */
export interface Figures {
  displayed: number;
  rendered: number;
  displayed_per_second: number | null;
  rendered_per_second: number | null;
  interval_median_ms: number | null;
  interval_95_percent_ms: number | null;
  frame_ms: number;
  overhead_ms: number;
  /** Share of exact pixels, 0 to 1. */
  exact_share: number;
  width: number;
  height: number;
  backend: "cpu" | "gpu";
  scene: string;
  gaussians: number;
  /** Whether no more frames are made until something happens. */
  idle: boolean;
  /** Whether the native image is shown. */
  native: boolean;
  opening: boolean;
  /** What could not be done, and why. */
  message: string | null;
}

/**
 * Events: "frame" and "idle" with `detail: Figures`; "error" with `detail: {message}` after which the viewer is closed; "save" with
 * `detail: {name, bytes}`, which `preventDefault()` keeps from the downloads; "choose" when the user asks for files to open, which
 * `preventDefault()` keeps from the browser's dialog.
 */
export interface Viewer extends EventTarget {
  /** Opens a scene or cameras: a URL, "demo", a file, the files of one folder, or a scene and its cameras. */
  open(source: string | Blob | Iterable<File>): void;
  camera(): Promise<Camera>;
  setCamera(camera: Camera): Promise<void>;
  setFps(fps: number): Promise<void>;
  setPanels(areShown: boolean): Promise<void>;
  /** Presses and releases a key, as `KeyboardEvent.key` names it. */
  press(key: string): void;
  /** Threads of the CPU that render. */
  readonly threads: number;
  readonly figures: Figures;
  destroy(): void;
}

/** Shows scenes in `canvas`. Rejects with one line where that cannot be. */
export function createViewer(canvas: HTMLCanvasElement, options?: ViewerOptions): Promise<Viewer>;
