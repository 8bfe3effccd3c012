"use strict";
/* The map of a page: drag to move, wheel or + and - to zoom, point at a thing to read what it is, slide through time.
   Every <figure class="scene"> holds its data as JSON; without scripts its picture stays. */
for (const figure of document.querySelectorAll("figure.scene")) showScene(figure);

function showScene(figure) {
  const data = JSON.parse(figure.querySelector("script").textContent);
  const canvas = document.createElement("canvas");
  const tip = document.createElement("div");
  const bar = document.createElement("div");
  tip.className = "tip";
  bar.className = "bar";
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", data.label);
  const frame = document.createElement("div");
  frame.className = "view";
  frame.append(canvas, tip);
  figure.prepend(frame, bar);
  figure.querySelector(".still")?.remove();

  const style = () => getComputedStyle(document.documentElement);
  const context = canvas.getContext("2d");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const hidden = new Set(data.hidden);
  const times = data.tracks.flatMap((track) => (track.t.length ? [track.t[0], track.t[track.t.length - 1]] : []));
  const begin = Math.min(...times), end = Math.max(...times);
  let now = end, playing = 0;
  let scale = 1, centre = [0, 0];
  const ground = new Image();
  if (data.grid) {
    ground.onload = draw;
    ground.src = data.grid.png;
  }

  function fit() {
    const [x0, x1, y0, y1] = data.extent;
    const { clientWidth: w, clientHeight: h } = canvas;
    scale = 0.94 * Math.min(w / Math.max(x1 - x0, 1e-9), h / Math.max(y1 - y0, 1e-9));
    centre = [(x0 + x1) / 2, (y0 + y1) / 2];
  }
  const toX = (x) => canvas.clientWidth / 2 + (x - centre[0]) * scale;
  const toY = (y) => canvas.clientHeight / 2 - (y - centre[1]) * scale;
  const fromX = (px) => centre[0] + (px - canvas.clientWidth / 2) / scale;
  const fromY = (py) => centre[1] - (py - canvas.clientHeight / 2) / scale;
  const upTo = (track) => {
    let low = 0, high = track.t.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (track.t[middle] <= now) low = middle + 1;
      else high = middle;
    }
    return low;
  };

  function draw() {
    const density = window.devicePixelRatio || 1;
    const { clientWidth: w, clientHeight: h } = canvas;
    if (canvas.width !== Math.round(w * density) || canvas.height !== Math.round(h * density)) {
      canvas.width = Math.round(w * density);
      canvas.height = Math.round(h * density);
    }
    context.setTransform(density, 0, 0, density, 0, 0);
    context.clearRect(0, 0, w, h);
    const ink = style().getPropertyValue("--fg").trim(), line = style().getPropertyValue("--line").trim();
    drawGraticule(w, h, ink, line);
    if (data.grid && ground.complete && !hidden.has(data.grid.layer)) {
      const [x0, x1, y0, y1] = data.grid.extent;
      context.imageSmoothingEnabled = scale * data.grid.cell < 1.5;
      context.filter = dark.matches ? "invert(0.86)" : "none";
      context.drawImage(ground, toX(x0), toY(y1), (x1 - x0) * scale, (y1 - y0) * scale);
      context.filter = "none";
    }
    for (const lines of data.lines) if (!hidden.has(lines.layer)) drawLines(lines);
    for (const track of data.tracks) if (!hidden.has(track.layer)) drawTrack(track);
    for (const points of data.points) if (!hidden.has(points.layer)) drawPoints(points, ink);
    for (const track of data.tracks) if (!hidden.has(track.layer)) drawRobot(track, ink);
  }

  function drawGraticule(w, h, ink, line) {
    const rough = 90 / scale, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= rough);
    context.strokeStyle = line;
    context.fillStyle = ink;
    context.font = "11px system-ui, sans-serif";
    context.lineWidth = 1;
    context.globalAlpha = 0.75;
    context.beginPath();
    for (let x = Math.ceil(fromX(0) / step) * step; x < fromX(w); x += step) {
      context.moveTo(toX(x), 0);
      context.lineTo(toX(x), h);
      context.fillText(number(x, step), toX(x) + 3, h - 5);
    }
    for (let y = Math.ceil(fromY(h) / step) * step; y < fromY(0); y += step) {
      context.moveTo(0, toY(y));
      context.lineTo(w, toY(y));
      context.fillText(number(y, step), 3, toY(y) - 3);
    }
    context.stroke();
    context.globalAlpha = 1;
    context.fillText("x, y in m", w - 58, 13);
  }

  function drawLines(lines) {
    context.strokeStyle = lines.colour;
    context.lineWidth = 1.2;
    context.setLineDash(lines.dashed ? [4, 3] : []);
    context.beginPath();
    for (const [ax, ay, bx, by] of lines.segments) {
      context.moveTo(toX(ax), toY(ay));
      context.lineTo(toX(bx), toY(by));
    }
    context.stroke();
    context.setLineDash([]);
  }

  function drawTrack(track) {
    const reached = upTo(track);
    context.strokeStyle = track.colour;
    context.lineWidth = 1.6;
    for (const [from, to, alpha] of [[0, reached, 1], [Math.max(0, reached - 1), track.t.length, 0.22]]) {
      context.globalAlpha = alpha;
      context.beginPath();
      for (let i = from; i < to; i++) {
        if (i === from) context.moveTo(toX(track.x[i]), toY(track.y[i]));
        else context.lineTo(toX(track.x[i]), toY(track.y[i]));
      }
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  function drawRobot(track, ink) {
    const i = upTo(track) - 1;
    if (i < 0) return;
    const x = toX(track.x[i]), y = toY(track.y[i]);
    if (track.ellipses) ellipse(x, y, track.ellipses[i], track.colour);
    context.save();
    context.translate(x, y);
    context.rotate(-track.theta[i]);
    context.fillStyle = track.colour;
    context.strokeStyle = ink;
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(9, 0);
    context.lineTo(-6, 5.5);
    context.lineTo(-6, -5.5);
    context.closePath();
    context.fill();
    context.stroke();
    context.restore();
  }

  function ellipse(x, y, [a, b, angle], colour) {
    context.strokeStyle = colour;
    context.lineWidth = 1;
    context.beginPath();
    context.ellipse(x, y, Math.max(a * scale, 0.1), Math.max(b * scale, 0.1), -angle, 0, 2 * Math.PI);
    context.stroke();
  }

  function drawPoints(points, ink) {
    const named = points.named && points.x.length * 900 < canvas.clientWidth * canvas.clientHeight * Math.max(1, scale / start);
    context.font = "11px system-ui, sans-serif";
    for (let i = 0; i < points.x.length; i++) {
      const x = toX(points.x[i]), y = toY(points.y[i]);
      if (points.ellipses) ellipse(x, y, points.ellipses[i], points.colour);
      context.fillStyle = points.colour;
      context.beginPath();
      context.arc(x, y, 3, 0, 2 * Math.PI);
      context.fill();
      if (named) {
        context.fillStyle = ink;
        context.fillText(points.names[i], x + 6, y - 5);
      }
    }
  }

  function nearest(px, py) {
    let best = null, least = 12;
    const consider = (x, y, text) => {
      const far = Math.hypot(toX(x) - px, toY(y) - py);
      if (far < least) {
        least = far;
        best = text;
      }
    };
    for (const points of data.points)
      if (!hidden.has(points.layer))
        for (let i = 0; i < points.x.length; i++) consider(points.x[i], points.y[i], () => points.texts[i]);
    if (!best)
      for (const track of data.tracks)
        if (!hidden.has(track.layer))
          for (let i = 0; i < track.t.length; i++)
            consider(track.x[i], track.y[i], () => poseText(track, i));
    if (!best)
      for (const lines of data.lines)
        if (!hidden.has(lines.layer))
          lines.segments.forEach(([ax, ay, bx, by], i) => consider((ax + bx) / 2, (ay + by) / 2, () => lines.texts[i]));
    return best && best();
  }
  function poseText(track, i) {
    const sure = track.ellipses ? `\n95 % within ${metres(track.ellipses[i][0])} × ${metres(track.ellipses[i][1])}` : "";
    const at = `(${track.x[i].toFixed(2)}, ${track.y[i].toFixed(2)}) m`;
    return `${track.name}, ${(track.t[i] - begin).toFixed(1)} s\n${at}, ${((track.theta[i] * 180) / Math.PI).toFixed(0)}°${sure}`;
  }

  function zoom(factor, px = canvas.clientWidth / 2, py = canvas.clientHeight / 2) {
    const x = fromX(px), y = fromY(py);
    scale = Math.min(Math.max(scale * factor, start / 20), start * 2000);
    centre[0] += x - fromX(px);
    centre[1] += y - fromY(py);
    draw();
  }

  const held = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held.set(event.pointerId, [event.offsetX, event.offsetY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const here = [event.offsetX, event.offsetY], before = held.get(event.pointerId);
    if (!before) {
      const text = nearest(...here);
      tip.textContent = text || "";
      tip.style.display = text ? "block" : "none";
      tip.style.left = `${Math.min(here[0] + 14, canvas.clientWidth - 150)}px`;
      tip.style.top = `${here[1] + 14}px`;
      return;
    }
    if (held.size === 2) {
      const other = [...held].find(([id]) => id !== event.pointerId)[1];
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      zoom(apart(here) / Math.max(apart(before), 1), (here[0] + other[0]) / 2, (here[1] + other[1]) / 2);
    } else {
      centre[0] -= (here[0] - before[0]) / scale;
      centre[1] += (here[1] - before[1]) / scale;
      draw();
    }
    held.set(event.pointerId, here);
  });
  for (const over of ["pointerup", "pointercancel"])
    canvas.addEventListener(over, (event) => held.delete(event.pointerId));
  canvas.addEventListener("pointerleave", () => (tip.style.display = "none"));
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls until the map is clicked
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 400), event.offsetX, event.offsetY);
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (move) {
      centre[0] += (60 * move[0]) / scale;
      centre[1] += (60 * move[1]) / scale;
      draw();
    } else if (event.key === "+" || event.key === "=") zoom(1.25);
    else if (event.key === "-") zoom(0.8);
    else if (event.key === "0") reset();
    else return;
    event.preventDefault();
  });

  function button(text, title, action) {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.title = title;
    made.setAttribute("aria-label", title);
    made.addEventListener("click", action);
    bar.append(made);
    return made;
  }
  function reset() {
    fit();
    draw();
  }
  button("+", "closer", () => zoom(1.4));
  button("−", "farther", () => zoom(1 / 1.4));
  button("⤢", "all of it", reset);
  const layers = [...new Map([
    ...(data.grid ? [[data.grid.layer, ""]] : []),
    ...[...data.lines, ...data.tracks, ...data.points].map((thing) => [thing.layer, thing.colour]),
  ])];
  for (const [layer, colour] of layers) {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox";
    box.checked = !hidden.has(layer);
    box.addEventListener("change", () => {
      if (box.checked) hidden.delete(layer);
      else hidden.add(layer);
      draw();
    });
    const mark = document.createElement("i");
    if (colour) mark.style.background = colour;
    label.append(box, mark, layer);
    bar.append(label);
  }
  if (end > begin) {
    const slider = document.createElement("input"), shown = document.createElement("output");
    slider.type = "range";
    slider.min = 0;
    slider.max = 1000;
    slider.value = 1000;
    slider.setAttribute("aria-label", "time");
    const tell = () => (shown.textContent = `${(now - begin).toFixed(0)} s`);
    slider.addEventListener("input", () => {
      now = begin + ((end - begin) * slider.value) / 1000;
      tell();
      draw();
    });
    const play = button("▶", "play", () => {
      playing = playing ? 0 : performance.now();
      play.textContent = playing ? "❚❚" : "▶";
      if (playing && now >= end) now = begin;
      let last = playing;
      const tick = (time) => {
        if (!playing) return;
        now = Math.min(end, now + ((end - begin) * (time - last)) / 12000);
        last = time;
        slider.value = (1000 * (now - begin)) / (end - begin);
        tell();
        draw();
        if (now < end) requestAnimationFrame(tick);
        else {
          playing = 0;
          play.textContent = "▶";
        }
      };
      if (playing) requestAnimationFrame(tick);
    });
    bar.append(slider, shown);
    tell();
  }
  fit();
  let start = scale;
  new ResizeObserver(() => {
    const zoomed = scale / start, kept = centre;
    fit();
    start = scale;
    scale = start * zoomed;
    if (Math.abs(zoomed - 1) > 1e-9) centre = kept;
    draw();
  }).observe(canvas);
  dark.addEventListener("change", draw);
  window.addEventListener("beforeprint", draw);
}
function number(value, step) {
  return value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
}
function metres(value) {
  return value < 0.1 ? `${(1000 * value).toFixed(0)} mm` : `${value.toFixed(2)} m`;
}
