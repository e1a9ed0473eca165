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

  // A cell: a text, or {text, level}, {text, action, value, off, sure} for a button, {links: [{text, href}]}.
  function showCell(cell, td) {
    const shown = JSON.stringify(cell);
    if (td.dataset.shown === shown) return;
    td.dataset.shown = shown;
    const value = typeof cell === "string" ? {text: cell} : cell;
    if (value.action) {
      let button = td.querySelector("button");
      if (!button) { td.replaceChildren(button = document.createElement("button")); button.type = "button"; }
      button.className = "hl-primary" + (value.sure ? " hl-sure" : "");
      button.dataset.action = value.action; button.dataset.value = value.value;
      button.disabled = Boolean(value.off);
      setText(button, value.text);
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

  function showControl(id, {off, hidden, value, choices}) {
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
    const from = byId(control.dataset.from || "");
    send({action: control.dataset.action, value: from ? from.value : control.dataset.value || ""});
  });
  document.addEventListener("change", (event) => {
    const control = event.target;
    if (control.dataset.change) send({action: control.dataset.change, value: control.value});
    if (control.dataset.upload) upload(control);
  });
  document.addEventListener("DOMContentLoaded", showSwitch);

  function update(shown) {
    Object.entries(shown.tables || {}).forEach(([name, rows]) => showTable(name, rows));
    Object.entries(shown.controls || {}).forEach(([id, state]) => showControl(id, state));
    Object.entries(shown.texts || {}).forEach(([id, text]) => setText(byId(id), text));
    if (shown.sound !== undefined) {
      if (soundNumber !== null && shown.sound !== soundNumber && isSoundOn()) beep();
      soundNumber = shown.sound;
      showSwitch();
    }
  }

  return {update, send};
})();
