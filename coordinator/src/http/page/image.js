// The picture: keeps means, standard errors and counts as they come, and shows one of three maps of them. All that one sees is
// computed here, from the numbers that one reads under the pointer.

const UNKNOWN = [52, 54, 60, 255];
// Relative errors shown: 0.1 % to 100 %, by their logarithm.
const ERROR_LOW = 1e-3, ERROR_DECADES = 3;
const ZOOM_MAX = 64;
// Rows painted at a time.
const STRIP = 128;

const srgb = Uint8Array.from({ length: 16385 }, (_, i) => {
  const x = i / 16384;
  return Math.round(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055));
});

// Viridis (van der Walt & Smith 2015) at nine points, joined by straight lines.
const VIRIDIS = [[68, 1, 84], [71, 44, 122], [59, 81, 139], [44, 113, 142], [33, 144, 141], [39, 173, 129], [92, 200, 99], [170, 220, 50], [253, 231, 37]];
export const ramp = Array.from({ length: 256 }, (_, i) => {
  const at = i / 255 * (VIRIDIS.length - 1), low = Math.min(Math.floor(at), VIRIDIS.length - 2), t = at - low;
  return VIRIDIS[low].map((a, c) => Math.round(a + t * (VIRIDIS[low + 1][c] - a)));
});

export class Picture {
  constructor(canvas, told) {
    this.canvas = canvas;
    this.told = told;
    this.map = "image";
    this.exposure = 0;
    this.whole = document.createElement("canvas");
    this.pointers = new Map();
    this.clear();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.listen();
  }

  clear() {
    this.width = this.height = 0;
    this.tiles = new Map();
    this.marker = null;
    this.fitted = true;
    this.countMax = 0;
    this.draw();
  }

  // Takes an answer of the coordinator; gives its version and whether there is more.
  take(buffer) {
    const view = new DataView(buffer), u32 = (at) => view.getUint32(at, true);
    if (u32(0) !== 1) throw new Error("this page is older than the coordinator: load it again");
    const more = u32(4) === 1, version = u32(8) + u32(12) * 2 ** 32;
    const [x0, y0, x1, y1, step] = [16, 20, 24, 28, 32].map(u32);
    const width = Math.ceil((x1 - x0) / step), height = Math.ceil((y1 - y0) / step);
    if (width !== this.width || height !== this.height || x0 !== this.x0 || y0 !== this.y0) this.begin(x0, y0, step, width, height);
    let at = 40, counted = this.countMax;
    for (let i = u32(36); i > 0; i--) {
      const [x, y, w, h] = [at, at + 4, at + 8, at + 12].map(u32);
      const count = u32(at + 16) + u32(at + 20) * 2 ** 32;
      const means = new Float32Array(buffer, at + 24, 3 * w * h), errors = new Uint16Array(buffer, at + 24 + 12 * w * h, 3 * w * h);
      this.put((x - x0) / step, (y - y0) / step, w, h, count, means, errors);
      at += 24 + Math.ceil(18 * w * h / 4) * 4;
    }
    if (this.map === "samples" && counted !== this.countMax) this.paint();
    this.draw();
    return { version, more };
  }

  begin(x0, y0, step, width, height) {
    this.clear();
    Object.assign(this, { x0, y0, step, width, height });
    this.mean = new Float32Array(3 * width * height);
    this.error = new Uint16Array(3 * width * height);
    this.count = new Float32Array(width * height);
    Object.assign(this.whole, { width, height });
    this.context = this.whole.getContext("2d");
    this.context.fillStyle = `rgb(${UNKNOWN.slice(0, 3)})`;
    this.context.fillRect(0, 0, width, height);
    this.fit();
  }

  put(x, y, w, h, count, means, errors) {
    const n = w * h;
    let variance = 0, power = 0;
    for (let row = 0; row < h; row++) {
      for (let column = 0; column < w; column++) {
        const from = row * w + column, to = (y + row) * this.width + x + column;
        this.count[to] = count;
        for (let c = 0; c < 3; c++) {
          const mean = means[c * n + from], error = errors[c * n + from];
          this.mean[3 * to + c] = mean;
          this.error[3 * to + c] = error;
          const sigma = upper(error);
          variance += sigma * sigma;
          power += mean * mean;
        }
      }
    }
    this.countMax = Math.max(this.countMax, count);
    this.tiles.set(`${x} ${y}`, { n, variance, power });
    this.paint(x, y, w, h);
  }

  // The relative error of all, by the same formula as the coordinator's; null while parts are missing.
  relativeError() {
    let n = 0, variance = 0, power = 0;
    for (const tile of this.tiles.values()) n += tile.n, variance += tile.variance, power += tile.power;
    const known = n > 0 && n === this.width * this.height && Number.isFinite(variance) && power > 0;
    return known ? Math.sqrt(variance / power) : null;
  }

  show(map) {
    this.map = map;
    this.paint();
    this.draw();
  }

  expose(stops) {
    this.exposure = stops;
    if (this.map === "image") this.paint();
    this.draw();
  }

  paint(x0 = 0, y0 = 0, w = this.width, h = this.height) {
    for (let y = y0; w > 0 && y < y0 + h; y += STRIP) {
      const rows = Math.min(STRIP, y0 + h - y), data = this.context.createImageData(w, rows);
      for (let row = 0; row < rows; row++) {
        for (let column = 0; column < w; column++) this.colour((y + row) * this.width + x0 + column, data.data, 4 * (row * w + column));
      }
      this.context.putImageData(data, x0, y);
    }
  }

  colour(i, out, at) {
    out[at + 3] = 255;
    if (this.count[i] === 0) return void out.set(UNKNOWN, at);
    if (this.map === "image") {
      const gain = 2 ** this.exposure;
      for (let c = 0; c < 3; c++) out[at + c] = srgb[Math.max(0, Math.min(16384, this.mean[3 * i + c] * gain * 16384)) | 0];
      return;
    }
    const t = this.map === "error" ? 1 + Math.log10(this.relative(i)) / ERROR_DECADES : this.count[i] / this.countMax;
    if (Number.isNaN(t) || t === Infinity) return void out.set(UNKNOWN, at);
    out.set(ramp[Math.max(0, Math.min(255, Math.round(255 * t)))], at);
  }

  // √Σσ² / √Σm² of a pixel; 0 / 0, black that is known to be black, is no error.
  relative(i) {
    let variance = 0, power = 0;
    for (let c = 3 * i; c < 3 * i + 3; c++) variance += upper(this.error[c]) ** 2, power += this.mean[c] ** 2;
    return variance === 0 ? ERROR_LOW : Math.sqrt(variance / power);
  }

  legend() {
    if (this.map === "error") return ["0.1 %", "100 %"];
    return this.map === "samples" ? ["0", this.countMax.toLocaleString("en")] : null;
  }

  resize() {
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(this.canvas.clientWidth * ratio);
    this.canvas.height = Math.round(this.canvas.clientHeight * ratio);
    this.fitted ? this.fit() : this.draw();
  }

  // Pixels of the screen a pixel of the film.
  fit() {
    const { width, height } = this.canvas;
    if (this.width === 0 || width === 0) return this.draw();
    const scale = Math.min(width / this.width, height / this.height);
    this.place(scale, (width - scale * this.width) / 2, (height - scale * this.height) / 2);
    this.fitted = true;
  }

  place(scale, left, top) {
    const { width, height } = this.canvas, keep = 32;
    this.scale = scale;
    this.left = Math.max(keep - scale * this.width, Math.min(width - keep, left));
    this.top = Math.max(keep - scale * this.height, Math.min(height - keep, top));
    this.fitted = false;
    this.draw();
  }

  // Zooms about a point of the canvas: what is there stays there.
  zoom(factor, x = this.canvas.width / 2, y = this.canvas.height / 2) {
    if (this.width === 0) return;
    const small = 16 / Math.max(this.width, this.height), scale = Math.max(small, Math.min(ZOOM_MAX, this.scale * factor)), by = scale / this.scale;
    this.place(scale, x - by * (x - this.left), y - by * (y - this.top));
  }

  one() {
    this.zoom(1 / this.scale);
  }

  draw() {
    if (this.asked) return;
    this.asked = requestAnimationFrame(() => {
      this.asked = 0;
      this.drawNow();
    });
  }

  drawNow() {
    const context = this.canvas.getContext("2d"), { width, height } = this.canvas;
    context.clearRect(0, 0, width, height);
    if (this.width > 0) {
      context.imageSmoothingEnabled = this.scale < 1;
      context.imageSmoothingQuality = "high";
      context.drawImage(this.whole, this.left, this.top, this.scale * this.width, this.scale * this.height);
      if (this.marker) this.mark(context);
    }
    this.told(this.reading(), this.spoken);
    this.spoken = false;
  }

  mark(context) {
    const side = Math.max(this.scale, 5), { x, y } = this.marker;
    const left = this.left + (x + 0.5) * this.scale - side / 2, top = this.top + (y + 0.5) * this.scale - side / 2;
    context.lineWidth = 3;
    context.strokeStyle = "#000";
    context.strokeRect(left, top, side, side);
    context.lineWidth = 1;
    context.strokeStyle = "#fff";
    context.strokeRect(left, top, side, side);
  }

  // What is known of the marked pixel.
  reading() {
    if (!this.marker) return null;
    const { x, y } = this.marker, i = y * this.width + x;
    const channels = [0, 1, 2].map((c) => ({ mean: this.mean[3 * i + c], error: upper(this.error[3 * i + c]) }));
    return { x: this.x0 + x * this.step, y: this.y0 + y * this.step, channels, count: this.count[i], relative: this.relative(i) };
  }

  point(x, y) {
    const clamp = (value, size) => Math.max(0, Math.min(size - 1, value));
    this.marker = this.width > 0 ? { x: clamp(x, this.width), y: clamp(y, this.height) } : null;
    this.draw();
  }

  listen() {
    const { canvas } = this, ratio = () => canvas.width / canvas.clientWidth;
    const at = (event) => ({ x: event.offsetX * ratio(), y: event.offsetY * ratio() });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const { x, y } = at(event);
      this.zoom(2 ** (-event.deltaY / 240), x, y);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, at(event));
    });
    canvas.addEventListener("pointermove", (event) => {
      const now = at(event), before = this.pointers.get(event.pointerId);
      if (this.width === 0) return;
      if (!before) return this.point(Math.floor((now.x - this.left) / this.scale), Math.floor((now.y - this.top) / this.scale));
      const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
      this.pointers.set(event.pointerId, now);
      if (!other) return this.place(this.scale, this.left + now.x - before.x, this.top + now.y - before.y);
      const far = (a) => Math.hypot(a.x - other.x, a.y - other.y);
      this.zoom(far(now) / Math.max(1, far(before)), (now.x + other.x) / 2, (now.y + other.y) / 2);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => {
      this.pointers.delete(event.pointerId);
      const { x, y } = at(event);
      if (end === "pointerup" && this.width > 0) this.point(Math.floor((x - this.left) / this.scale), Math.floor((y - this.top) / this.scale));
    });
  }

  // Whether a key was for the picture.
  key(event) {
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (arrow && event.shiftKey) {
      const { x, y } = this.marker ?? { x: this.width >> 1, y: this.height >> 1 };
      this.spoken = true;
      this.point(x + arrow[0], y + arrow[1]);
    } else if (arrow) this.place(this.scale, this.left - 60 * arrow[0], this.top - 60 * arrow[1]);
    else if (event.key === "+" || event.key === "=") this.zoom(2 ** 0.5);
    else if (event.key === "-") this.zoom(2 ** -0.5);
    else if (event.key === "0") this.fit();
    else if (event.key === "1") this.one();
    else return false;
    return true;
  }
}

// The f32 whose upper half this is.
const words = new Uint32Array(1), floats = new Float32Array(words.buffer);
function upper(half) {
  words[0] = half << 16;
  return floats[0];
}
