"use strict";
/* Signals within the page: report.values(id) gives numbers, null where there is none. */
const report = (() => {
  const held = JSON.parse(document.getElementById("data").textContent);
  const decoded = new Map();

  function decode(kept) {
    const text = atob(kept.data), bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const values = kept.type === "f8" ? new Float64Array(bytes.buffer) : new Float32Array(bytes.buffer);
    return values.every(Number.isFinite) ? values : Array.from(values, (v) => (Number.isFinite(v) ? v : null));
  }

  function values(id, like) {
    const kept = held.arrays[id];
    if (!kept) return null;
    if (kept.data === undefined) return new Array(values(like).length).fill(kept.constant);
    if (!decoded.has(id)) decoded.set(id, decode(kept));
    return decoded.get(id);
  }

  return { values, charts: held.charts, scene: held.scene };
})();
