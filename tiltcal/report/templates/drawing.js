"use strict";
(() => {
  const variable = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const coloured = (value) => {
    if (typeof value === "string") return value.startsWith("var(--") ? variable(value.slice(4, -1)) : value;
    if (Array.isArray(value)) return value.map(coloured);
    if (value && typeof value === "object") return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, coloured(v)]));
    return value;
  };
  const axis = (given) => ({ gridcolor: variable("--line"), zerolinecolor: variable("--soft"), zerolinewidth: 1, linecolor: variable("--line"), automargin: true, ...given });
  const layout = (given, height, narrow) => {
    const found = { font: { family: "system-ui, sans-serif", size: 12, color: variable("--ink") }, paper_bgcolor: variable("--paper"), plot_bgcolor: variable("--paper"),
      margin: { l: 55, r: 12, t: 8, b: 42 }, hoverlabel: { bgcolor: variable("--panel"), bordercolor: variable("--soft"), font: { color: variable("--ink") }, namelength: -1 },
      legend: { orientation: "h", x: 0, y: 1 + 6 / Math.max(height - 60, 60), yanchor: "bottom" }, ...coloured(given) };
    if (found.scene) {
      for (const name of ["xaxis", "yaxis", "zaxis"]) found.scene[name] = { backgroundcolor: variable("--panel"), ...axis(found.scene[name]) };
    } else {
      for (const name of new Set(["xaxis", "yaxis", ...Object.keys(found).filter((key) => /^[xy]axis\d*$/.test(key))])) {
        found[name] = axis(found[name]);
        if (narrow) found[name].tickfont = { size: 10 };
      }
    }
    return found;
  };
  const globe = () => {
    const path = [[], [], []];
    const circle = (point) => {
      for (let k = 0; k <= 36; k += 1) point(k * Math.PI / 18).forEach((v, i) => path[i].push(v));
      path.forEach((part) => part.push(null));
    };
    for (const level of [-60, -30, 0, 30, 60].map((d) => d * Math.PI / 180)) circle((t) => [Math.cos(level) * Math.cos(t), Math.cos(level) * Math.sin(t), Math.sin(level)]);
    for (const around of [0, 30, 60, 90, 120, 150].map((d) => d * Math.PI / 180)) circle((t) => [Math.cos(t) * Math.cos(around), Math.cos(t) * Math.sin(around), Math.sin(t)]);
    const quiet = { type: "scatter3d", hoverinfo: "skip", showlegend: false };
    return [{ ...quiet, mode: "lines", x: path[0], y: path[1], z: path[2], opacity: 0.5, line: { color: variable("--soft"), width: 1.5 } },
      { ...quiet, mode: "text", x: [1.2, -1.2, 0, 0, 0, 0], y: [0, 0, 1.2, -1.2, 0, 0], z: [0, 0, 0, 0, 1.2, -1.2], text: ["+x", "-x", "+y", "-y", "+z", "-z"], textfont: { color: variable("--ink"), size: 13 } }];
  };
  const draw = (figure, { data, layout: given, frames }, more) => {
    const series = coloured(data);
    if (given.sphere) { series.push(...globe()); delete given.sphere; }
    const options = { displaylogo: false, responsive: true, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d", "sendDataToCloud"], ...more };
    return Plotly.newPlot(figure, { data: series, layout: layout(given, figure.clientHeight, figure.clientWidth < 500), frames: coloured(frames || []), config: options });
  };
  globalThis.tiltcalDrawing = { draw };
})();
