"use strict";
/* What is where on a canvas that shows a map, in reports and live: drag, arrows or two fingers move, wheel or + and -
   zoom, 0 shows all, f fills the screen; m measures between two clicks. The place under the pointer stands beside it. */
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));

// extent: () => [x0, x1, y0, y1] of all there is, or nothing; hover: (px, py) under the pointer, nothing when it leaves;
// click: (px, py); drag: (dx, dy, event) in metres, whether something else than the map moves
function viewport(canvas, extent, draw, { unit = "m", hover = () => {}, wheel = () => true, click = () => {}, drag = () => false } = {}) {
  const v = { scale: 0, x: 0, y: 0, whole: 0, moved: false, measuring: false, ends: [] };
  const wide = () => canvas.clientWidth, high = () => canvas.clientHeight;
  v.toX = (x) => wide() / 2 + (x - v.x) * v.scale;
  v.toY = (y) => high() / 2 - (y - v.y) * v.scale;
  v.fromX = (px) => v.x + (px - wide() / 2) / v.scale;
  v.fromY = (py) => v.y - (py - high() / 2) / v.scale;

  const where = document.createElement("output");
  where.className = "where";
  where.setAttribute("aria-live", "off");
  canvas.after(where);

  // all of it fills the canvas, until somebody moves
  v.fit = () => {
    const box = extent();
    if (!box || !wide() || !high()) return; // a page that is not shown has no size, and comes back
    const [x0, x1, y0, y1] = box, [across, along] = [Math.max(wide() - 72, wide() / 2), Math.max(high() - 56, high() / 2)];
    v.whole = Math.min(across / Math.max(x1 - x0, 1e-9), along / Math.max(y1 - y0, 1e-9));
    if (!v.moved) [v.scale, v.x, v.y] = [v.whole, (x0 + x1) / 2, (y0 + y1) / 2];
  };
  v.resized = () => {
    const zoomed = v.scale / (v.whole || 1);
    v.fit();
    v.scale = v.whole * (v.moved ? zoomed : 1);
    draw();
  };
  v.all = () => {
    v.moved = false;
    v.fit();
    draw();
  };
  v.zoom = (factor, px = wide() / 2, py = high() / 2) => {
    const x = v.fromX(px), y = v.fromY(py);
    v.scale = Math.min(Math.max(v.scale * factor, v.whole / 20), v.whole * 2000);
    v.pan(x - v.fromX(px), y - v.fromY(py));
  };
  v.pan = (dx, dy) => {
    [v.x, v.y, v.moved] = [v.x + dx, v.y + dy, true];
    draw();
  };
  v.measure = (on = !v.measuring) => {
    [v.measuring, v.ends] = [on, []];
    canvas.classList.toggle("measuring", on);
    where.textContent = on ? "click where to measure from" : "";
    draw();
  };
  v.fill = () => (document.fullscreenElement ? document.exitFullscreen() : canvas.parentElement.requestFullscreen?.());

  // lines at round numbers, each written at the rim by `mark(text, px, py)`; letters: their height [px]
  v.graticule = (pen, ink, line, letters, mark = (...text) => pen.fillText(...text)) => {
    const rough = 90 / v.scale, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= rough);
    const number = (value) => value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
    pen.strokeStyle = line;
    pen.fillStyle = ink;
    pen.font = `${letters}px system-ui, sans-serif`;
    pen.lineWidth = 1;
    pen.globalAlpha = 0.75;
    for (let x = Math.ceil(v.fromX(0) / step) * step; x < v.fromX(wide()); x += step) {
      stroke(pen, [[v.toX(x), 0], [v.toX(x), high()]]);
      mark(number(x), v.toX(x) + 3, high() - 5);
    }
    for (let y = Math.ceil(v.fromY(high()) / step) * step; y < v.fromY(0); y += step) {
      stroke(pen, [[0, v.toY(y)], [wide(), v.toY(y)]]);
      mark(number(y), 3, v.toY(y) - 3);
    }
    pen.globalAlpha = 1;
  };

  // a bar of a round length, and what is measured; on top of everything
  v.overlay = (pen, ink) => {
    const rough = 120 / v.scale, power = 10 ** Math.floor(Math.log10(rough));
    const long = [5, 2, 1].map((k) => k * power).find((l) => l <= rough), right = wide() - 14, low = high() - 24;
    pen.strokeStyle = pen.fillStyle = ink;
    pen.lineWidth = 2;
    pen.font = "11px system-ui, sans-serif";
    stroke(pen, [[right - long * v.scale, low - 4], [right - long * v.scale, low], [right, low], [right, low - 4]]);
    const text = `${+long.toPrecision(1)}${unit && " "}${unit}`;
    pen.fillText(text, right - pen.measureText(text).width, low - 8);
    if (v.ends.length > 1) stroke(pen, v.ends.map(([x, y]) => [v.toX(x), v.toY(y)]));
    for (const [x, y] of v.ends) pen.fillRect(v.toX(x) - 3, v.toY(y) - 3, 6, 6);
  };
  function stroke(pen, points) {
    pen.beginPath();
    for (const point of points) pen.lineTo(...point);
    pen.stroke();
  }
  function tell(px, py) {
    const digits = Math.max(0, Math.min(3, Math.ceil(Math.log10(v.scale))));
    const [x, y] = [v.fromX(px), v.fromY(py)];
    if (v.measuring && v.ends.length) {
      const [[ax, ay], [bx, by]] = [v.ends[0], v.ends[1] || [x, y]], turn = (Math.atan2(by - ay, bx - ax) * 180) / Math.PI;
      where.textContent = `${Math.hypot(bx - ax, by - ay).toFixed(digits)} ${unit}, ${turn.toFixed(1)}° from x`;
    } else if (v.scale && !v.measuring) where.textContent = `x ${x.toFixed(digits)}, y ${y.toFixed(digits)} ${unit}`;
  }

  const held = new Map();
  let began = null;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, (began = [event.offsetX, event.offsetY]));
  });
  canvas.addEventListener("pointermove", (event) => {
    const here = [event.offsetX, event.offsetY], before = held.get(event.pointerId);
    tell(...here);
    if (!before) return hover(...here);
    if (held.size === 2) {
      const other = [...held].find(([id]) => id !== event.pointerId)[1];
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      v.zoom(apart(here) / Math.max(apart(before), 1), (here[0] + other[0]) / 2, (here[1] + other[1]) / 2);
    } else if (!drag((here[0] - before[0]) / v.scale, (before[1] - here[1]) / v.scale, event))
      v.pan((before[0] - here[0]) / v.scale, (here[1] - before[1]) / v.scale);
    held.set(event.pointerId, here);
  });
  canvas.addEventListener("pointerup", (event) => {
    const [px, py] = [event.offsetX, event.offsetY];
    const still = began && Math.hypot(px - began[0], py - began[1]) < 4;
    if (still && !v.measuring) click(px, py);
    else if (still) {
      v.ends = [...(v.ends.length > 1 ? [] : v.ends), [v.fromX(px), v.fromY(py)]];
      tell(px, py);
      draw();
    }
    held.delete(event.pointerId);
  });
  canvas.addEventListener("pointercancel", (event) => held.delete(event.pointerId));
  canvas.addEventListener("pointerleave", () => {
    if (!v.measuring) where.textContent = "";
    hover();
  });
  canvas.addEventListener("dblclick", () => v.measuring || v.all());
  canvas.addEventListener("wheel", (event) => {
    if (!wheel(event)) return;
    event.preventDefault();
    v.zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const step = 60 / v.scale;
    const act = {
      ArrowLeft: () => v.pan(-step, 0), ArrowRight: () => v.pan(step, 0), ArrowUp: () => v.pan(0, step),
      ArrowDown: () => v.pan(0, -step), "+": () => v.zoom(1.25), "=": () => v.zoom(1.25), "-": () => v.zoom(0.8),
      0: v.all, m: () => v.measure(), f: v.fill, Escape: () => v.measure(false),
    }[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    act();
    event.preventDefault();
  });
  return v;
}
