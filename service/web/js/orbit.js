// One camera that turns around a point: mouse, touch, wheel, keys and buttons all end in the same few moves.

const RADIANS = Math.PI / 180;

export class Orbit {
  #start;

  constructor({ center, radius, isRoom }, changed) {
    this.#start = { target: [...center], yaw: 25, pitch: -12, distance: radius * (isRoom ? 0.3 : 3) };
    this.radius = radius;
    this.changed = changed;
    this.reset();
  }

  reset() {
    Object.assign(this, { ...this.#start, target: [...this.#start.target] });
    this.changed();
  }

  /** Turn by degrees. */
  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.max(-89, Math.min(89, this.pitch + pitch));
    this.changed();
  }

  /** Nearer (factor below 1) or farther. */
  zoom(factor) {
    this.distance = Math.max(this.radius / 50, Math.min(this.radius * 20, this.distance * factor));
    this.changed();
  }

  /** Shift the point in the middle, in parts of the picture's height. */
  shift(right, up) {
    const { x, y } = this.axes();
    for (let d = 0; d < 3; d += 1) this.target[d] += this.distance * (right * x[d] + up * y[d]);
    this.changed();
  }

  axes() {
    const [cy, sy, cp, sp] = [
      Math.cos(this.yaw * RADIANS), Math.sin(this.yaw * RADIANS),
      Math.cos(this.pitch * RADIANS), Math.sin(this.pitch * RADIANS),
    ];
    return { x: [cy, 0, -sy], y: [sy * sp, cp, cy * sp], z: [sy * cp, -sp, cy * cp] };
  }

  get position() {
    const { z } = this.axes();
    return this.target.map((value, d) => value + this.distance * z[d]);
  }

  /** Listen on an element: drag turns, Shift or the right button shifts, wheel and pinch zoom, keys do all of it. */
  listen(element) {
    const pointers = new Map();
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, event);
    });
    const drop = (event) => pointers.delete(event.pointerId);
    element.addEventListener("pointerup", drop);
    element.addEventListener("pointercancel", drop);
    element.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const [dx, dy, size] = [event.clientX - before.clientX, event.clientY - before.clientY, element.clientHeight];
      if (pointers.size === 2) this.#pinch(event, pointers, size);
      else if (event.buttons === 2 || event.shiftKey) this.shift(-dx / size, dy / size);
      else this.turn((-dx / size) * 180, (-dy / size) * 180);
      pointers.set(event.pointerId, event);
    });
    element.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaY)) / 300));
    }, { passive: false });
    element.addEventListener("keydown", (event) => {
      const move = this.#keys(event.shiftKey)[event.key];
      if (!move || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      move();
    });
  }

  #pinch(event, pointers, size) {
    const other = [...pointers.values()].find((pointer) => pointer.pointerId !== event.pointerId);
    const before = pointers.get(event.pointerId);
    const span = (pointer) => Math.hypot(pointer.clientX - other.clientX, pointer.clientY - other.clientY) || 1;
    this.zoom(span(before) / span(event));
    this.shift((before.clientX - event.clientX) / size / 2, (event.clientY - before.clientY) / size / 2);
  }

  #keys(shifted) {
    const arrow = (x, y) => () => (shifted ? this.shift(x * 0.06, y * 0.06) : this.turn(x * 8, -y * 8));
    return {
      ArrowLeft: arrow(-1, 0), ArrowRight: arrow(1, 0), ArrowUp: arrow(0, 1), ArrowDown: arrow(0, -1),
      "+": () => this.zoom(0.85), "=": () => this.zoom(0.85), "-": () => this.zoom(1 / 0.85), Home: () => this.reset(),
    };
  }
}
