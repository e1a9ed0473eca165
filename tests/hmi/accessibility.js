// Checks of the shown page; each returns what does not meet its limit, as texts.
({
  // Controls smaller than `limit` px in width or height.
  smallTargets: (limit) =>
    [...document.querySelectorAll("button, a, select, input:not([type=range]), .q-slider")]
      .filter((e) => e.offsetParent !== null)
      .map((e) => [e.textContent.trim() || e.name || e.className, e.getBoundingClientRect()])
      .filter(([, box]) => box.width < limit - 0.5 || box.height < limit - 0.5)
      .map(([name, box]) => `${name}: ${box.width} x ${box.height}`),

  // Texts whose contrast with the colour behind them (WCAG 2.2) is below `limit`, or that are translucent (not those that are invisible).
  lowContrasts: (limit) => {
    const parse = (color) => (color.match(/[\d.]+/g) || []).map(Number);
    const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    const light = ([r, g, b]) => 0.2126 * linear(r / 255) + 0.7152 * linear(g / 255) + 0.0722 * linear(b / 255);
    const behind = (e) => {
      for (; e; e = e.parentElement) {
        const color = parse(getComputedStyle(e).backgroundColor);
        if (color.length && (color[3] === undefined || color[3] === 1)) return color;
      }
      return [255, 255, 255];
    };
    const opacity = (e) => (e ? Number(getComputedStyle(e).opacity) * opacity(e.parentElement) : 1);
    const found = [];
    for (const e of document.querySelectorAll("body *")) {
      const hasText = [...e.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
      if (!hasText || e.offsetParent === null || ["SCRIPT", "STYLE"].includes(e.tagName)) continue;
      const [a, b] = [light(parse(getComputedStyle(e).color)), light(behind(e))];
      const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      if (opacity(e) > 0 && (ratio < limit || opacity(e) < 1)) {
        found.push(`${e.textContent.trim().slice(0, 40)}: ${ratio.toFixed(1)}, opacity ${opacity(e)}`);
      }
    }
    return found;
  },
})
