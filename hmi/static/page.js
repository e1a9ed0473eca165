// Operator's page: shows the sections that the server sends, and draws the map. No other server is contacted.
"use strict";
window.headland = (() => {
  const STALE_MS = 2000; // without an update: what is shown is old
  const BAR_LIGHTS = 21, BAR_STEP_CM = 2;
  const SECTION_COLORS = {swath: "#1d4ed8", headland: "#0b4a23", turn: "#7a8594", lane: "#5b3a1e", detour: "#b45a00", dock: "#5b3a1e"};
  const CLICK_PX = 6; // a longer movement of the pointer moves the map
  const COLORS = {person: "#8a3b00", animal: "#5b2a86"};
  const map = {still: null, moving: null, paths: [], trail: [], edges: [], scale: 7, follow: true, center: [0, 0], draft: null, isOpen: false};
  const ANSWER_MS = 1000; // between two answers to updates: this page is there
  let updatedMs = performance.now(), answeredMs = 0;

  const byId = (id) => document.getElementById(id);

  function text(element, value) {
    if (element && element.textContent !== value) element.textContent = value;
  }

  function showRows(name, rows) {
    const body = byId("rows-" + name);
    if (!body) return;
    while (body.children.length > rows.length) body.lastChild.remove();
    rows.forEach(([key, label, value, sign, level, symbol], k) => {
      let row = body.children[k];
      if (!row) {
        row = document.createElement("div");
        row.append(...["dt", "dd"].map((tag) => document.createElement(tag)));
        row.firstChild.append(document.createElement("span"));
        body.append(row);
      }
      row.dataset.key = key;
      row.className = "hl-row hl-" + level;
      text(row.firstChild.lastChild, label);
      showSymbol(row.firstChild, symbol || "");
      text(row.children[1], sign ? sign + " " + value : value);
    });
  }

  function showSymbol(element, name) { // before the text of an element, from the sprite of the page
    if ((element.dataset.symbol || "") === name) return;
    element.dataset.symbol = name;
    element.querySelector("svg")?.remove();
    if (!name) return;
    const [svg, use] = ["svg", "use"].map((tag) => document.createElementNS("http://www.w3.org/2000/svg", tag));
    svg.setAttribute("class", "hl-symbol"); svg.setAttribute("aria-hidden", "true");
    use.setAttribute("href", "#symbol-" + name);
    svg.append(use); element.prepend(svg);
  }

  function showState([mode, level, cause, next, symbol]) {
    byId("state").className = "hl-mode hl-" + level;
    showSymbol(byId("state"), symbol);
    text(byId("mode"), mode);
    text(byId("cause"), cause);
    text(byId("next"), next);
  }

  function showBar(xteCm) { // left positive: the machine is left of the path, the lit lights are on the left
    const bar = byId("bar"), middle = (BAR_LIGHTS - 1) / 2;
    if (!bar.children.length) for (let k = 0; k < BAR_LIGHTS; k++) bar.append(document.createElement("i"));
    const offset = xteCm === null ? null : Math.max(-middle, Math.min(middle, Math.round(-xteCm / BAR_STEP_CM)));
    [...bar.children].forEach((light, k) => {
      const at = k - middle;
      const lit = offset !== null && (at === 0 ? offset === 0 : at * offset > 0 && Math.abs(at) <= Math.abs(offset));
      light.className = (at === 0 ? "hl-middle" : Math.abs(at) > 5 ? "hl-far" : "") + (lit ? " hl-lit" : "");
    });
  }

  function line(context, points, toPx, close) {
    if (!points || points.length < 2) return false;
    context.beginPath();
    points.forEach((point, k) => { const [x, y] = toPx(point); k ? context.lineTo(x, y) : context.moveTo(x, y); });
    if (close) context.closePath();
    return true;
  }

  function stroke(context, points, toPx, color, width, close, dash) {
    if (!line(context, points, toPx, close)) return;
    context.strokeStyle = color; context.lineWidth = width; context.setLineDash(dash || []); context.stroke();
    context.setLineDash([]);
  }

  function fill(context, points, toPx, color) {
    if (!line(context, points, toPx, true)) return;
    context.fillStyle = color; context.fill();
  }

  function drawTrack(context, track, toPx, scale, labels) {
    const [x, y] = toPx(track.at), size = Math.max(6, 0.5 * scale * Math.max(...track.size));
    const isLiving = track.class in COLORS, isMoving = Math.hypot(...track.velocity) > 0.2, color = COLORS[track.class] || "#333";
    context.strokeStyle = color; context.fillStyle = color; context.lineWidth = isLiving || isMoving ? 3 : 1.5;
    context.beginPath();
    if (track.class === "person") context.arc(x, y, size, 0, 2 * Math.PI);
    else if (track.class === "animal") { context.moveTo(x, y - size); context.lineTo(x + size, y + size); context.lineTo(x - size, y + size); context.closePath(); }
    else { // box of the object
      const c = Math.cos(track.yaw), s = Math.sin(track.yaw), [a, b] = track.size.map((v) => 0.5 * v);
      [[a, b], [-a, b], [-a, -b], [a, -b]].forEach(([u, v], k) => {
        const [px, py] = toPx([track.at[0] + c * u - s * v, track.at[1] + s * u + c * v]);
        k ? context.lineTo(px, py) : context.moveTo(px, py);
      });
      context.closePath();
    }
    context.stroke();
    if (isMoving) stroke(context, [track.at, [track.at[0] + 2 * track.velocity[0], track.at[1] + 2 * track.velocity[1]]], toPx, color, 4);
    if (!isLiving && !isMoving) return; // standing objects: box without label
    context.font = "600 16px sans-serif";
    const width = context.measureText(track.text).width;
    if (labels.some(([u, v, w]) => u < x + size + width + 9 && x + size + 3 < u + w && Math.abs(v - y) < 22)) return; // overlaps one
    labels.push([x + size + 3, y, width + 6]);
    context.fillStyle = "#fff"; context.fillRect(x + size + 3, y - 11, width + 6, 22);
    context.fillStyle = "#111"; context.fillText(track.text, x + size + 6, y + 6);
  }

  function draw() {
    const canvas = byId("map");
    if (!canvas || !map.still) return;
    const ratio = Math.min(2, window.devicePixelRatio || 1), box = canvas.getBoundingClientRect();
    const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const moving = map.moving || {}, pose = moving.pose;
    if (map.follow && pose) map.center = pose.slice(0, 2);
    const context = canvas.getContext("2d"), scale = map.scale;
    const toPx = ([x, y]) => [box.width / 2 + (x - map.center[0]) * scale, box.height / 2 - (y - map.center[1]) * scale];
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = "#f4f1ea"; context.fillRect(0, 0, box.width, box.height);
    const still = map.still;
    fill(context, still.boundary, toPx, "#fffef8");
    for (let k = 1; k < map.edges.length; k++) {
      const [s0, ...a] = map.edges[k - 1], [s1, ...b] = map.edges[k];
      if (s0 === s1) fill(context, [a.slice(0, 2), a.slice(2), b.slice(2), b.slice(0, 2)], toPx, "#b9d8a8");
    }
    still.plan.forEach((path) => stroke(context, path, toPx, "#7a8594", 1));
    (still.sections || []).forEach(([kind, path]) => stroke(context, path, toPx, SECTION_COLORS[kind] || "#333", kind === "turn" ? 1 : 2));
    map.paths.forEach((path) => stroke(context, path, toPx, "#1d4ed8", 2));
    stroke(context, still.guide, toPx, "#6b1fa3", 3, false, [14, 6]);
    stroke(context, still.boundary, toPx, "#14532d", 3, true);
    stroke(context, still.yard, toPx, "#555", 2, true, [8, 6]);
    still.lanes.forEach((lane) => stroke(context, lane, toPx, "#555", 2, false, [2, 6]));
    still.no_go.forEach((area) => { fill(context, area, toPx, "#f3c7c7"); stroke(context, area, toPx, "#a30014", 3, true); });
    still.walls.forEach((wall) => stroke(context, wall, toPx, "#5b3a1e", 4));
    still.gates.forEach((gate) => stroke(context, gate, toPx, "#fff", 4));
    (still.margins || []).forEach((ends) => stroke(context, ends, toPx, "#b45a00", 4, false, [4, 6]));
    (still.labels || []).forEach(([at, label]) => drawLabel(context, toPx(at), label));
    stroke(context, map.trail, toPx, "#111", 2);
    const triggered = moving.points && moving.points.length > 0;
    fill(context, moving.field, toPx, triggered ? "rgba(163,0,20,0.30)" : "rgba(11,61,145,0.15)");
    stroke(context, moving.field, toPx, triggered ? "#a30014" : "#0b3d91", 2, true);
    (moving.bodies || []).forEach((body, k) => { fill(context, body, toPx, k ? "#c9a227" : "#2f6f3e"); stroke(context, body, toPx, "#111", 2, true); });
    if (pose) { // nose of the machine
      const [x, y, yaw] = pose, at = (d, e) => [x + d * Math.cos(yaw) - e * Math.sin(yaw), y + d * Math.sin(yaw) + e * Math.cos(yaw)];
      fill(context, [at(3.6, 0), at(1.6, 0.9), at(1.6, -0.9)], toPx, "#fff");
    }
    (moving.points || []).forEach((point) => { const [x, y] = toPx(point); context.fillStyle = "#a30014"; context.fillRect(x - 2, y - 2, 5, 5); });
    const labels = [];
    (moving.tracks || []).forEach((track) => drawTrack(context, track, toPx, scale, labels));
    if (map.draft) drawDraft(context, toPx);
    if (byId("map-waiting")) byId("map-waiting").hidden = Boolean(pose);
  }

  function drawLabel(context, [x, y], label) { // numbered place
    context.font = "600 16px sans-serif";
    const width = context.measureText(label).width + 12;
    context.fillStyle = "#7a0010"; context.fillRect(x - width / 2, y - 12, width, 24);
    context.fillStyle = "#fff"; context.fillText(label, x - width / 2 + 6, y + 6);
  }

  function drawDraft(context, toPx) { // outline that is drawn, with its corners
    stroke(context, map.draft, toPx, "#7a0010", 3, !map.isOpen, [10, 5]);
    map.draft.forEach((corner) => {
      const [x, y] = toPx(corner);
      context.fillStyle = "#7a0010"; context.beginPath(); context.arc(x, y, 7, 0, 2 * Math.PI); context.fill();
    });
  }

  function showAll() {
    const canvas = byId("map"), xs = map.still.boundary.concat(map.still.yard);
    if (!canvas) return; // the view has changed since
    const [lowX, highX] = [0, 1].map((k) => Math[k ? "max" : "min"](...xs.map((p) => p[0])));
    const [lowY, highY] = [0, 1].map((k) => Math[k ? "max" : "min"](...xs.map((p) => p[1])));
    const box = canvas.getBoundingClientRect();
    map.scale = 0.92 * Math.min(box.width / (highX - lowX), box.height / (highY - lowY));
    map.center = [0.5 * (lowX + highX), 0.5 * (lowY + highY)];
    map.follow = false; draw();
  }

  function zoom(factor) { map.scale = Math.min(60, Math.max(0.2, map.scale * factor)); draw(); }

  function watchMap() {
    const canvas = byId("map");
    let last = null, first = null;
    canvas.addEventListener("pointerdown", (event) => { first = last = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", (event) => {
      if (first && map.draft) addCorner(event);
      first = last = null;
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      if (first && Math.hypot(event.clientX - first[0], event.clientY - first[1]) > CLICK_PX) first = null;
      if (first) return;
      map.center = [map.center[0] - (event.clientX - last[0]) / map.scale, map.center[1] + (event.clientY - last[1]) / map.scale];
      map.follow = false; last = [event.clientX, event.clientY]; draw();
    });
    byId("map-larger").onclick = () => zoom(1.5);
    byId("map-smaller").onclick = () => zoom(1 / 1.5);
    byId("map-all").onclick = showAll;
    if (byId("map-follow")) byId("map-follow").onclick = () => { map.follow = true; if (map.scale < 4) map.scale = 7; draw(); };
    new ResizeObserver(draw).observe(canvas);
  }

  function addCorner(event) {
    const box = byId("map").getBoundingClientRect();
    const x = map.center[0] + (event.clientX - box.left - box.width / 2) / map.scale;
    const y = map.center[1] - (event.clientY - box.top - box.height / 2) / map.scale;
    window.headlandControls.send({action: "corner", x, y});
  }

  function showStill(still) {
    const isFirst = !map.still;
    map.still = still;
    if (isFirst) watchMap();
    if (!byId("map-follow")) showAll(); // a map without machine shows the field
  }

  function update(shown) {
    window.headlandControls.update(shown);
    if (shown.space || shown.camera) window.headlandSurroundings.update(shown);
    updatedMs = performance.now();
    if (updatedMs - answeredMs > ANSWER_MS) { answeredMs = updatedMs; window.headlandControls.send({action: "present"}); }
    if (shown.clear) { map.trail = []; map.edges = []; }
    if (shown.still) showStill(shown.still);
    if (shown.is_open !== undefined) map.isOpen = shown.is_open;
    if (shown.draft !== undefined) {
      if (shown.draft && !map.draft) byId("map").scrollIntoView({block: "nearest"}); // it waits for clicks
      map.draft = shown.draft;
    }
    if (shown.trail) map.trail.push(...shown.trail);
    if (shown.edges) map.edges.push(...shown.edges);
    if (shown.map) map.moving = shown.map;
    if (shown.paths) map.paths = shown.paths;
    if (shown.state) showState(shown.state);
    if (shown.bar !== undefined) showBar(shown.bar);
    Object.entries(shown.rows || {}).forEach(([name, rows]) => showRows(name, rows));
    if (shown.replay) text(byId("replay-time"), shown.replay[0] + " / " + shown.replay[1]);
    if (shown.map || shown.paths || shown.still || shown.trail || shown.draft !== undefined) draw();
  }

  setInterval(() => {
    const lost = byId("lost");
    if (!lost) return; // the page is still loading
    lost.hidden = performance.now() - updatedMs < STALE_MS;
    document.body.classList.toggle("hl-stale", !lost.hidden);
  }, 250);

  return {update, COLORS};
})();
