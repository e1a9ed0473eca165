// Tables, controls and events of the views. All texts are set as text, never as HTML. No other server is contacted.
"use strict";
window.headlandControls = (() => {
  const MAX_BYTES = 20e6;
  const byId = (id) => document.getElementById(id);
  let soundNumber = null, audio = null;

  function setText(element, value) {
    if (element && element.textContent !== value) element.textContent = value;
  }

  function send(values) { if (window.emitEvent) window.emitEvent("headland", values); }

  // A cell: a text, or {text, level}, {text, action, value, off, sure} for a button, {links: [{text, href}]},
  // {input, key, label, off, level, choices} for a value that is edited.
  function showCell(cell, td) {
    const shown = JSON.stringify(cell);
    if (td.dataset.shown === shown && !cell.key) return;
    td.dataset.shown = shown;
    const value = typeof cell === "string" ? {text: cell} : cell;
    if (value.action) {
      let button = td.querySelector("button");
      if (!button) { td.replaceChildren(button = document.createElement("button")); button.type = "button"; }
      button.className = "hl-primary" + (value.sure ? " hl-sure" : "");
      button.dataset.action = value.action; button.dataset.value = value.value;
      button.disabled = Boolean(value.off);
      setText(button, value.text);
    } else if (value.key) {
      let input = td.firstElementChild;
      if (!input) {
        input = document.createElement(value.choices ? "select" : "input");
        if (value.choices) input.replaceChildren(...value.choices.map(([one, text]) => new Option(text, one)));
        else input.autocomplete = "off";
        td.replaceChildren(input);
      }
      input.dataset.change = "edit"; input.dataset.key = value.key; input.setAttribute("aria-label", value.label);
      input.disabled = Boolean(value.off);
      if (document.activeElement !== input || input.dataset.sent) input.value = value.input; // nobody is typing
      delete input.dataset.sent;
      td.className = value.level ? "hl-" + value.level : "";
    } else if (value.links) {
      td.replaceChildren(...value.links.map((one) => {
        const link = document.createElement("a");
        link.href = one.href; link.textContent = one.text; link.className = "hl-link"; link.download = "";
        return link;
      }));
    } else {
      td.className = value.level ? "hl-" + value.level : "";
      td.textContent = value.text;
    }
  }

  function showTable(name, rows) {
    const table = byId("table-" + name);
    if (!table) return;
    const body = table.tBodies[0];
    while (body.rows.length > rows.length) body.lastChild.remove();
    rows.forEach((cells, k) => {
      const row = body.rows[k] || body.insertRow();
      while (row.cells.length < cells.length) row.insertCell();
      cells.forEach((cell, j) => showCell(cell, row.cells[j]));
    });
    table.hidden = rows.length === 0;
    byId("empty-" + name).hidden = rows.length > 0;
  }

  function showControl(id, {off, hidden, value, choices, text, sure}) {
    const control = byId(id);
    if (!control) return;
    control.disabled = Boolean(off);
    (control.closest("label") || control).hidden = Boolean(hidden);
    if (choices) {
      const listed = JSON.stringify(choices);
      if (control.dataset.listed !== listed) {
        control.dataset.listed = listed;
        control.replaceChildren(...choices.map(([key, text]) => new Option(text, key)));
      }
    }
    if (value !== undefined && control.value !== value) control.value = value;
    if (text !== undefined) setText(control, text);
    if (sure !== undefined) control.classList.toggle("hl-sure", sure);
  }

  // Sound of alarms: a switch for each browser, kept there.
  const isSoundOn = () => localStorage.getItem("headland-sound") !== "off";
  function showSwitch() {
    const button = byId("sound");
    if (!button) return;
    button.setAttribute("aria-pressed", String(isSoundOn()));
    setText(button, isSoundOn() ? button.dataset.on : button.dataset.off);
  }
  function wake() {
    if (!audio) audio = new AudioContext();
    if (audio.state === "suspended") audio.resume();
  }
  function beep() {
    wake();
    [0, 0.25].forEach((delay) => {
      const tone = audio.createOscillator(), volume = audio.createGain();
      tone.frequency.value = 880; volume.gain.value = 0.2;
      tone.connect(volume).connect(audio.destination);
      tone.start(audio.currentTime + delay); tone.stop(audio.currentTime + delay + 0.15);
    });
  }

  async function upload(input) {
    const files = [...input.files], answer = byId("answer");
    if (!files.length) return;
    const failed = (text) => { setText(answer, text); input.value = ""; };
    if (files.reduce((sum, file) => sum + file.size, 0) > MAX_BYTES) { failed(input.dataset.large); return; }
    const form = new FormData();
    files.forEach((file) => form.append("field", file));
    try {
      const reply = await fetch(input.dataset.upload, {method: "POST", body: form});
      failed(reply.ok ? "" : await reply.text());
    } catch { failed(input.dataset.failed); }
  }

  document.addEventListener("click", (event) => {
    if (audio || isSoundOn()) wake();
    const control = event.target.closest("[data-action], #sound");
    if (!control || control.disabled) return;
    if (control.id === "sound") {
      localStorage.setItem("headland-sound", isSoundOn() ? "off" : "on");
      showSwitch();
      return;
    }
    const from = (control.dataset.from || "").split(" ").filter(Boolean).map((id) => byId(id).value);
    const frame = document.querySelector("iframe.hl-stop");
    if (control.dataset.action === "self_test" && frame) { // by the process of the emergency stop alone
      const address = new URL(frame.src);
      address.pathname = "/check";
      frame.src = address.href;
    }
    send({action: control.dataset.action, value: from.length ? from.join(" ") : control.dataset.value || ""});
  });
  document.addEventListener("change", (event) => {
    const control = event.target;
    if (control.dataset.key) control.dataset.sent = "1";
    if (control.dataset.change) send({action: control.dataset.change, value: control.value, key: control.dataset.key || ""});
    if (control.dataset.upload) upload(control);
  });
  document.addEventListener("DOMContentLoaded", showSwitch);

  // Plot of points and a line, with the ends of both axes: {x, y, points, line, title}.
  function showPlot(plot) {
    const svg = byId("plot");
    if (!svg) return;
    byId("plot-box").hidden = !plot;
    if (!plot) { svg.replaceChildren(); return; }
    const all = plot.points.concat(plot.line), [left, right, top, bottom] = [70, 590, 20, 250];
    const ends = [0, 1].map((k) => [Math.min(...all.map((p) => p[k])), Math.max(...all.map((p) => p[k]))]);
    const span = ends.map(([low, high]) => high - low || 1);
    const toPx = ([x, y]) => [left + (right - left) * (x - ends[0][0]) / span[0], bottom - (bottom - top) * (y - ends[1][0]) / span[1]];
    const add = (name, values, content) => {
      const element = document.createElementNS("http://www.w3.org/2000/svg", name);
      Object.entries(values).forEach(([key, value]) => element.setAttribute(key, value));
      element.textContent = content || "";
      return element;
    };
    const path = plot.line.map(toPx).map(([x, y], k) => (k ? "L" : "M") + x.toFixed(1) + " " + y.toFixed(1)).join("");
    const text = (x, y, anchor, content) => add("text", {x, y, "text-anchor": anchor}, content);
    const round = (value) => String(Number(value.toPrecision(4)));
    svg.replaceChildren(
      add("path", {d: `M${left} ${top}V${bottom}H${right}`, class: "hl-axis"}),
      ...plot.points.map(toPx).map(([cx, cy]) => add("circle", {cx: cx.toFixed(1), cy: cy.toFixed(1), r: 3})),
      add("path", {d: path, class: "hl-fit"}),
      text(left - 6, bottom, "end", round(ends[1][0])), text(left - 6, top + 12, "end", round(ends[1][1])),
      text(left, bottom + 20, "start", round(ends[0][0])), text(right, bottom + 20, "end", round(ends[0][1])),
      text((left + right) / 2, bottom + 38, "middle", plot.x), text(left, top - 6, "start", plot.y));
    svg.setAttribute("aria-label", plot.title);
  }

  function update(shown) {
    if (shown.plot !== undefined) showPlot(shown.plot);
    Object.entries(shown.tables || {}).forEach(([name, rows]) => showTable(name, rows));
    Object.entries(shown.controls || {}).forEach(([id, state]) => showControl(id, state));
    Object.entries(shown.texts || {}).forEach(([id, text]) => setText(byId(id), text));
    if (shown.light !== undefined) {
      const light = byId("light");
      setText(light, shown.light ? "⚠ " + shown.light : "");
      light.hidden = !shown.light;
    }
    if (shown.sound !== undefined) {
      if (soundNumber !== null && shown.sound !== soundNumber && isSoundOn()) beep();
      soundNumber = shown.sound;
      showSwitch();
    }
  }

  return {update, send};
})();
