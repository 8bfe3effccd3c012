/* Deciding on places and robots, on a page of `mapweave edit`. */
const by = (id) => document.getElementById(id);
let state = null, shown = null, chosen = null, hand = [0, 0, 0], box = null, busy = false;

async function ask(path, asked = {}) {
  if (busy) return;
  busy = true;
  document.body.style.cursor = "progress";
  by("told").textContent = path === "/save" ? "saving" : "solving";
  try {
    const answer = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ ...(state && { edition: state.edition }), ...asked }) });
    const told = answer.headers.get("Content-Type") === "application/json" ? await answer.json() : { error: answer.statusText };
    if (told.error) by("told").textContent = told.error;
    else if (path === "/save") {
      state.saved = true;
      by("told").textContent = `saved: mapweave map LOGS --decisions ${told.file}${told.out ? ` gives what is now in ${told.out}` : ""}`;
    } else {
      show(told);
      if (told.stale) by("told").textContent = "not done: another page decided something since; this is what holds now";
    }
  } catch (error) {
    by("told").textContent = `mapweave edit does not answer any more: ${error.message}`;
  }
  busy = false;
  document.body.style.cursor = "";
}

function show(told) {
  const same = state && state.part === told.part, kept = same && shown ? { ...shown.view } : null, off = same && shown ? shown.hidden : null;
  state = told;
  chosen = null;
  const figure = document.createElement("figure"), data = document.createElement("script");
  figure.className = "scene";
  data.type = "application/json";
  if (off) state.scene.hidden = [...off];
  data.textContent = JSON.stringify(state.scene);
  figure.append(data);
  by("map").replaceChildren(figure);
  shown = showScene(figure);
  if (kept && kept.moved) {
    [shown.view.scale, shown.view.x, shown.view.y, shown.view.moved] = [kept.scale, kept.x, kept.y, true];
    shown.draw();
  }
  figure.pick = pick;
  figure.over = over;
  figure.drag = drag;
  const said = state.said ? `${state.said} decided by hand` : "as the scans say";
  by("told").textContent = `verdict: ${state.verdict}; ${said}${state.seconds ? `; solved in ${state.seconds.toFixed(1)} s` : ""}${state.saved ? "" : "; not saved"}`;
  by("undo").disabled = !state.undo;
  by("findings").replaceChildren(...state.findings.map((text) => element("li", text)));
  choices();
  pairs();
  pick(null);
}

function element(kind, text, title = "") {
  const made = document.createElement(kind);
  made.textContent = text;
  if (title) made.title = title;
  return made;
}

function choices() {
  const several = state.parts.length > 1;
  by("whole").hidden = by("other").hidden = !several;
  const option = (text, value) => Object.assign(element("option", text), { value });
  by("part").replaceChildren(...state.parts.map((text, k) => option(text, k)));
  by("part").value = state.part;
  const others = state.names.map((names, k) => [names.join(", "), k]).filter(([, k]) => k !== state.part);
  by("lay").replaceChildren(option("no other", ""), ...others.map(([text, k]) => option(text, k)));
  lay();
}

function lay() {
  const points = by("lay").value === "" ? null : state.outlines[+by("lay").value];
  by("hand").hidden = !points;
  by("turn").value = 0;
  if (points && points.length) {
    const { view } = shown, middle = (k) => points.reduce((sum, p) => sum + p[k], 0) / points.length;
    hand = [view.x - middle(0), view.y - middle(1), 0];
  }
  shown.draw();
}

// where the other map's frame lies, once its middle has turned by so much
function turnBy(angle) {
  const points = state.outlines[+by("lay").value], middle = [0, 1].map((k) => points.reduce((sum, p) => sum + p[k], 0) / points.length);
  const [x, y] = laid(middle);
  hand[2] += angle;
  const [nx, ny] = laid(middle);
  hand[0] += x - nx;
  hand[1] += y - ny;
  by("turn").value = (hand[2] * 180) / Math.PI;
  shown.draw();
}
function laid([x, y]) {
  const [c, s] = [Math.cos(hand[2]), Math.sin(hand[2])];
  return [hand[0] + c * x - s * y, hand[1] + s * x + c * y];
}
function drag(dx, dy, event) {
  if (by("cells").value !== "") {
    const edge = by("map").querySelector("canvas").getBoundingClientRect();
    const at = [shown.view.fromX(event.clientX - edge.left), shown.view.fromY(event.clientY - edge.top)];
    box = box ? [box[0], box[1], ...at] : [at[0] - dx, at[1] - dy, ...at];
    shown.draw();
    return true;
  }
  if (by("lay").value === "") return false;
  if (event.shiftKey) turnBy(dx * shown.view.scale * 0.005);
  else {
    [hand[0], hand[1]] = [hand[0] + dx, hand[1] + dy];
    shown.draw();
  }
  return true;
}

function boxDrawn() {
  if (!box) return;
  const asked = { box, cells: by("cells").value, part: state.part };
  [box, by("cells").value] = [null, ""];
  ask("/decide", asked);
}

function over(pen, view) {
  if (box) {
    const [x0, y0, x1, y1] = [view.toX(box[0]), view.toY(box[1]), view.toX(box[2]), view.toY(box[3])];
    pen.strokeStyle = css("--warn");
    pen.lineWidth = 2;
    pen.strokeRect(Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0));
  }
  if (by("lay").value !== "") {
    pen.fillStyle = css("--warn");
    for (const point of state.outlines[+by("lay").value]) {
      const [x, y] = laid(point);
      pen.fillRect(view.toX(x) - 1, view.toY(y) - 1, 2, 2);
    }
  }
  if (chosen === null) return;
  for (const lines of state.scene.lines)
    lines.segments.forEach(([ax, ay, bx, by_], i) => {
      if (!lines.ids || lines.ids[i] !== chosen) return;
      pen.strokeStyle = css("--accent");
      pen.lineWidth = 4;
      pen.beginPath();
      pen.moveTo(view.toX(ax), view.toY(ay));
      pen.lineTo(view.toX(bx), view.toY(by_));
      pen.stroke();
      for (const [x, y] of [[ax, ay], [bx, by_]]) {
        pen.beginPath();
        pen.arc(view.toX(x), view.toY(y), 6, 0, 2 * Math.PI);
        pen.stroke();
      }
    });
}

function pick(k) {
  chosen = k;
  by("place").hidden = k === null;
  if (k !== null) {
    const place = state.places[k], [first, second] = place.names.map((name, n) => `${name} at ${place.stamps[n].toFixed(1)} s`);
    const numbers = [place.score !== null && `score ${place.score.toFixed(2)}`, place.second !== null && `next best ${place.second.toFixed(2)}`,
      place.sd !== null && `${place.sd.toFixed(1)} sd from the rest`].filter(Boolean);
    by("place").querySelector("b").textContent = `${place.accepted ? "believed" : "refused"}: ${first}, ${second}`;
    by("place").querySelector("span").textContent = [place.reason, ...numbers].join("; ");
    for (const button of by("place").querySelectorAll("button"))
      button.disabled = button.dataset.word === (place.said || "undecided");
  }
  shown.draw();
}

function pairs() {
  by("robots").hidden = by("pairs").hidden = !state.pairs.length;
  const rows = state.pairs.map((pair) => {
    const row = document.createElement("tr"), words = document.createElement("td");
    for (const [word, text] of [["together", "one map"], ["apart", "apart"], ["undecided", "as the scans say"]]) {
      const button = element("button", text);
      button.disabled = word === (pair.said || "undecided");
      button.addEventListener("click", () => ask("/decide", { pair: pair.robots, decision: word, part: state.part }));
      words.append(button);
    }
    const why = element("td", pair.reason);
    why.className = "text";
    row.append(element("td", pair.names.join(", ")), element("td", pair.merged ? "one map" : "apart"), why, words);
    return row;
  });
  by("pairs").replaceChildren(...rows);
}

for (const button of by("place").querySelectorAll("button"))
  button.addEventListener("click", () => ask("/decide", { place: chosen, decision: button.dataset.word, part: state.part }));
by("undo").addEventListener("click", () => ask("/undo", { part: state.part }));
by("save").addEventListener("click", () => ask("/save"));
by("here").addEventListener("click", () => ask("/decide", { lay: +by("lay").value, part: state.part, pose: hand }));
by("part").addEventListener("change", () => ask("/state", { part: +by("part").value }));
by("lay").addEventListener("change", lay);
by("turn").addEventListener("input", () => turnBy((by("turn").value * Math.PI) / 180 - hand[2]));
window.addEventListener("pointerup", boxDrawn);
window.addEventListener("beforeunload", (event) => state && !state.saved && event.preventDefault());
ask("/state", {});
