/* The map of a page, on a viewport: point at a thing to read what it is, slide through time.
   Every <figure class="scene"> holds its data as JSON; without scripts its picture stays. */
const MOST_NAMES = 600; // in view, beyond which none is written
const SHAPES = {
  line: "M-8 0H8",
  dot: "M-3 0a3 3 0 1 0 6 0a3 3 0 1 0-6 0",
  ring: "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0-10 0",
  triangle: "M0-6L5 4H-5Z",
  cross: "M-4-4L4 4M-4 4L4-4",
  star: "M0-5.5L1.3-1.8 5.2-1.7 2.1.7 3.2 4.5 0 2.2-3.2 4.5-2.1.7-5.2-1.7-1.3-1.8Z",
};
const OPEN = ["line", "ring", "cross"]; // drawn as lines, the others filled
const ON_PAPER = { "--fg": "#1b1f24", "--line": "#d9dde2", "--free": "#ffffff", "--wall": "#24292f", "--unseen": "#e4e7eb" };
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

  const shade = (name) => (printing ? ON_PAPER[name] : css(name));
  const context = canvas.getContext("2d");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const hidden = new Set(data.hidden);
  const times = data.tracks.flatMap((track) => (track.t.length ? [track.t[0], track.t[track.t.length - 1]] : []));
  const begin = Math.min(...times), end = Math.max(...times);
  let now = end, playing = 0;
  let printing = false; // on white, finer than the screen, letters larger: paper is narrower
  const letters = () => (printing ? 16 : 11); // [px]
  const view = viewport(canvas, () => data.extent, draw, {
    unit: data.axes.endsWith(" m") ? "m" : "",
    hover: point,
    click: (px, py) => figure.pick?.(placeAt(px, py)), // an editor's page sets pick, drag and over
    drag: (...moved) => figure.drag?.(...moved) || false,
    wheel: (event) => event.ctrlKey || document.activeElement === canvas, // the page scrolls until the map is clicked
  });
  const { toX, toY, fromX, fromY } = view;
  const ground = document.createElement("canvas");
  let cells = null, since = null; // pixels of the grid; when each became known
  if (data.grid)
    Promise.all([pixelsOf(data.grid.png), data.grid.since && pixelsOf(data.grid.since)]).then(([all, when]) => {
      [cells, since] = [all, when];
      [ground.width, ground.height] = [all.width, all.height];
      paint();
      draw();
    });

  // the grid as it was known at the time shown, in the page's colours
  function paint() {
    if (!cells) return;
    const shown = new ImageData(cells.width, cells.height), to = shown.data;
    const kinds = ["--unseen", "--free", "--wall"].map((name) => [...rgb(shade(name)), 255]);
    for (let i = 0; i < to.length; i += 4) if (cells.data[i]) to.set(kinds[cells.data[i] > 200 ? 2 : 1], i);
    if (since && now < end) {
      const level = (data.grid.levels * (now - data.grid.begin)) / Math.max(data.grid.end - data.grid.begin, 1e-9);
      for (let i = 0; i < to.length; i += 4) if (since.data[i] > level) to[i + 3] = 0;
    }
    ground.getContext("2d").putImageData(shown, 0, 0);
  }

  const upTo = (track) => {
    let low = 0, high = track.t.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (track.t[middle] <= now) low = middle + 1;
      else high = middle;
    }
    return low;
  };

  // whether a landmark was known at the time shown
  const known = (points, i) => now >= end || !points.since || points.since[i] === null || points.since[i] <= now;

  function draw() {
    const density = Math.max(window.devicePixelRatio || 1, printing ? 2 : 0);
    const { clientWidth: w, clientHeight: h } = canvas;
    if (canvas.width !== Math.round(w * density) || canvas.height !== Math.round(h * density)) {
      canvas.width = Math.round(w * density);
      canvas.height = Math.round(h * density);
    }
    context.setTransform(density, 0, 0, density, 0, 0);
    context.clearRect(0, 0, w, h);
    const [ink, line] = [shade("--fg"), shade("--line")], { scale } = view;
    written = [];
    if (cells && !hidden.has(data.grid.layer)) {
      const [x0, x1, y0, y1] = data.grid.extent;
      context.fillStyle = shade("--unseen");
      context.fillRect(0, 0, w, h);
      context.imageSmoothingEnabled = scale * data.grid.cell < 1.5;
      context.drawImage(ground, toX(x0), toY(y1), (x1 - x0) * scale, (y1 - y0) * scale);
    }
    view.graticule(context, ink, line, letters(), mark);
    context.fillText(data.axes, w - context.measureText(data.axes).width - 6, letters() + 2);
    const seen = (things) => things.filter((thing) => !hidden.has(thing.layer));
    for (const lines of seen(data.lines)) drawLines(lines, ink);
    for (const track of seen(data.tracks)) drawTrack(track, ink);
    for (const points of seen(data.points)) drawPoints(points, ink, density);
    for (const track of seen(data.tracks)) drawRobot(track, ink);
    context.font = `${letters()}px system-ui, sans-serif`;
    context.fillStyle = ink;
    for (const track of seen(data.tracks)) if (track.named) nameRobot(track);
    for (const points of seen(data.points)) namePoints(points, w, h);
    figure.over?.(context, view);
    view.overlay(context, ink);
  }
  const tint = (colour, ink) => (colour === "#000000" ? ink : colour);

  // a name beside what it names, where it covers no other; where there is no such place it is left to pointing
  let written = [];
  function write(text, x, y) {
    const wide = context.measureText(text).width, tall = letters();
    for (const [left, top] of [[x + 6, y - 4 - tall], [x + 6, y + 4], [x - 6 - wide, y - 4 - tall], [x - 6 - wide, y + 4]]) {
      if (written.some(([l, t, r, b]) => left < r && l < left + wide && top < b && t < top + tall)) continue;
      written.push([left - 3, top - 1, left + wide + 3, top + tall + 1]);
      context.fillText(text, left, top + tall - 1);
      return;
    }
  }
  function nameRobot(track) {
    const i = upTo(track) - 1;
    if (i >= 0) write(track.name, toX(track.x[i]), toY(track.y[i]));
  }
  function namePoints(points, w, h) {
    if (!points.named) return;
    const inside = [];
    for (let i = 0; i < points.x.length; i++) {
      const x = toX(points.x[i]), y = toY(points.y[i]);
      if (known(points, i) && x > 0 && x < w && y > 0 && y < h) inside.push([points.names[i], x, y]);
    }
    if (inside.length <= MOST_NAMES) for (const one of inside) write(...one);
  }

  // a number of the graticule, which names keep clear of
  function mark(text, x, y) {
    const wide = context.measureText(text).width;
    if (x + wide > canvas.clientWidth || y < letters()) return; // it would be cut off
    context.fillText(text, x, y);
    written.push([x - 2, y - letters(), x + wide + 2, y + 3]);
  }

  function drawLines(lines, ink) {
    context.strokeStyle = tint(lines.colour, ink);
    context.lineWidth = 1.2;
    context.globalAlpha = lines.texts.length ? 1 : 0.6;
    context.setLineDash(lines.dashed ? [4, 3] : []);
    context.beginPath();
    for (const [ax, ay, bx, by] of lines.segments) {
      context.moveTo(toX(ax), toY(ay));
      context.lineTo(toX(bx), toY(by));
    }
    context.stroke();
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  function drawTrack(track, ink) {
    const broken = new Set(track.gaps); // before which nobody knows the way
    const reached = track.t.length ? upTo(track) : track.x.length;
    context.strokeStyle = tint(track.colour, ink);
    context.lineWidth = 1.6;
    for (const [from, to, alpha] of [[0, reached, 1], [Math.max(0, reached - 1), track.x.length, 0.22]]) {
      context.globalAlpha = alpha;
      context.beginPath();
      for (let i = from; i < to; i++) {
        if (i === from || broken.has(i)) context.moveTo(toX(track.x[i]), toY(track.y[i]));
        else context.lineTo(toX(track.x[i]), toY(track.y[i]));
      }
      context.stroke();
    }
    context.globalAlpha = 1;
    if (!track.t.length) return;
    context.beginPath(); // a ring where it began
    context.arc(toX(track.x[0]), toY(track.y[0]), 4, 0, 2 * Math.PI);
    context.stroke();
  }

  function drawRobot(track, ink) {
    const i = upTo(track) - 1;
    if (i < 0 || (track.leaves && i === track.t.length - 1 && now > track.t[i])) return;
    const x = toX(track.x[i]), y = toY(track.y[i]);
    if (track.ellipses) ellipse(x, y, track.ellipses[i], track.colour);
    context.save();
    context.translate(x, y);
    context.fillStyle = tint(track.colour, ink);
    context.strokeStyle = ink;
    context.lineWidth = 1;
    context.beginPath();
    if (track.theta) {
      context.rotate(-track.theta[i]);
      context.moveTo(9, 0);
      context.lineTo(-6, 5.5);
      context.lineTo(-6, -5.5);
      context.closePath();
    } else context.arc(0, 0, 5, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
    context.restore();
  }

  function ellipse(x, y, [a, b, angle], colour) {
    context.strokeStyle = colour;
    context.lineWidth = 1;
    context.beginPath();
    context.ellipse(x, y, Math.max(a * view.scale, 0.1), Math.max(b * view.scale, 0.1), -angle, 0, 2 * Math.PI);
    context.stroke();
  }

  function drawPoints(points, ink, density) {
    const shape = new Path2D(SHAPES[points.shape]), size = points.x.length > 2000 ? 0.5 : 1;
    context.fillStyle = context.strokeStyle = tint(points.colour, ink);
    const shown = points.x.map((_, i) => i).filter((i) => known(points, i));
    if (points.ellipses) for (const i of shown) ellipse(toX(points.x[i]), toY(points.y[i]), points.ellipses[i], context.strokeStyle);
    context.lineWidth = 1.5;
    for (const i of shown) {
      const k = density * size;
      context.setTransform(k, 0, 0, k, density * toX(points.x[i]), density * toY(points.y[i]));
      if (OPEN.includes(points.shape)) context.stroke(shape);
      else context.fill(shape);
    }
    context.setTransform(density, 0, 0, density, 0, 0);
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
        for (let i = 0; i < points.x.length; i++)
          if (known(points, i)) consider(points.x[i], points.y[i], () => pointText(points, i));
    if (!best)
      for (const track of data.tracks)
        if (!hidden.has(track.layer))
          for (let i = 0; i < track.t.length; i++)
            consider(track.x[i], track.y[i], () => poseText(track, i));
    if (!best)
      for (const lines of data.lines)
        if (!hidden.has(lines.layer) && lines.texts.length)
          lines.segments.forEach(([ax, ay, bx, by], i) => consider((ax + bx) / 2, (ay + by) / 2, () => lines.texts[i]));
    return best && best();
  }
  // the number of the place whose line is nearest
  function placeAt(px, py) {
    let best = null, least = 12;
    for (const lines of data.lines)
      if (lines.ids && !hidden.has(lines.layer))
        lines.segments.forEach(([ax, ay, bx, by], i) => {
          const [x, y, dx, dy] = [toX(ax), toY(ay), toX(bx) - toX(ax), toY(by) - toY(ay)];
          const along = Math.min(1, Math.max(0, ((px - x) * dx + (py - y) * dy) / (dx * dx + dy * dy || 1)));
          const far = Math.hypot(px - x - along * dx, py - y - along * dy);
          if (far < least) [least, best] = [far, lines.ids[i]];
        });
    return best;
  }
  function pointText(points, i) {
    if (points.texts.length) return points.texts[i];
    const sd = points.sd && points.sd[i] !== null ? `\nsd ${metres(points.sd[i])}` : "";
    return `${points.names[i]} (${points.layer})\n${data.axes.slice(0, 4)} = ${points.x[i].toFixed(3)}, ${points.y[i].toFixed(3)}${sd}`;
  }
  function poseText(track, i) {
    const sure = track.ellipses ? `\n95 % ellipse, half axes ${both(...track.ellipses[i])}` : "";
    const at = `(${track.x[i].toFixed(2)}, ${track.y[i].toFixed(2)}) m`;
    const heading = track.theta ? `, ${((track.theta[i] * 180) / Math.PI).toFixed(0)}°` : "";
    const notes = track.notes ? `\n${track.notes}` : "";
    return `${track.name}, ${when(track.t[i])}\n${at}${heading}${sure}${notes}`;
  }
  function when(t) {
    return data.clock === "s" ? `${(t - begin).toFixed(1)} s` : `${data.clock} ${t.toFixed(0)}`;
  }

  function point(px, py) {
    const text = px === undefined ? null : nearest(px, py);
    tip.textContent = text || "";
    tip.style.display = text ? "block" : "none";
    if (!text) return;
    tip.style.left = `${Math.max(0, Math.min(px + 14, canvas.clientWidth - tip.offsetWidth - 2))}px`;
    const under = py + 14 + tip.offsetHeight <= canvas.clientHeight;
    tip.style.top = `${under ? py + 14 : Math.max(0, py - 10 - tip.offsetHeight)}px`;
  }

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
  button("+", "closer (+)", () => view.zoom(1.4));
  button("−", "farther (-)", () => view.zoom(1 / 1.4));
  button("⤢", "all of it (0)", view.all);
  button("↔", "measure between two clicks (m)", () => view.measure());
  button("▣", "fill the screen (f)", view.fill);
  const layers = new Map(data.grid ? [[data.grid.layer, null]] : []);
  for (const { layer, colour, shape, dashed } of [...data.lines, ...data.tracks, ...data.points])
    layers.set(layer, (layers.get(layer)?.colour ?? colour) === colour ? { colour, shape, dashed } : null);
  for (const track of data.tracks)
    track.named = track.t.length && data.tracks.some((other) => other !== track && other.layer === track.layer);
  for (const [layer, look] of layers) {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox";
    box.checked = !hidden.has(layer);
    box.addEventListener("change", () => {
      if (box.checked) hidden.delete(layer);
      else hidden.add(layer);
      draw();
    });
    label.append(box, ...(look ? [legend(look)] : []), layer);
    bar.append(label);
  }
  if (end > begin) {
    const slider = document.createElement("input"), shown = document.createElement("output");
    slider.type = "range";
    slider.min = 0;
    slider.max = 1000;
    slider.value = 1000;
    slider.setAttribute("aria-label", "time");
    const tell = () => {
      shown.textContent = data.clock === "s" ? `${(now - begin).toFixed(0)} s` : `${data.clock} ${now.toFixed(0)}`;
      slider.setAttribute("aria-valuetext", shown.textContent);
    };
    const show = () => {
      if (since) paint();
      tell();
      draw();
    };
    slider.addEventListener("input", () => {
      now = slider.value === slider.max ? end : begin + ((end - begin) * slider.value) / 1000;
      show();
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
        show();
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
  new ResizeObserver(() => canvas.clientWidth && canvas.clientHeight && view.resized()).observe(canvas);
  dark.addEventListener("change", () => {
    paint();
    draw();
  });
  for (const [event, on] of [["beforeprint", true], ["afterprint", false]])
    window.addEventListener(event, () => {
      printing = on;
      paint();
      draw();
    });
  return { view, draw, hidden };
}
// the mark of a layer, as the map shows it
function legend({ colour, shape = "line", dashed }) {
  const mark = document.createElementNS("http://www.w3.org/2000/svg", "svg"), shown = colour === "#000000" ? "currentColor" : colour;
  mark.setAttribute("viewBox", "-8 -7 16 14");
  mark.setAttribute("aria-hidden", "true");
  mark.innerHTML = `<path d="${SHAPES[shape]}" fill="none"/>`;
  const path = mark.firstChild;
  path.setAttribute(OPEN.includes(shape) ? "stroke" : "fill", shown);
  path.setAttribute("stroke-width", shape === "line" ? 3 : 1.5);
  if (dashed) path.setAttribute("stroke-dasharray", "4 3");
  return mark;
}
async function pixelsOf(png) {
  const image = new Image();
  image.src = png;
  await image.decode();
  const sheet = document.createElement("canvas");
  [sheet.width, sheet.height] = [image.naturalWidth, image.naturalHeight];
  sheet.getContext("2d").drawImage(image, 0, 0);
  return sheet.getContext("2d").getImageData(0, 0, sheet.width, sheet.height);
}
function both(a, b) {
  return a < 0.1 ? `${(1000 * a).toFixed(0)} × ${(1000 * b).toFixed(0)} mm` : `${a.toFixed(2)} × ${b.toFixed(2)} m`;
}
function metres(value) {
  return value < 0.1 ? `${(1000 * value).toFixed(0)} mm` : `${value.toFixed(2)} m`;
}
