// A plot of a report, drawn as the reports draw it; where it is ranged, the visible range is told.
let loading;
const script = (address, name) => new Promise((resolve, reject) => {  // the page asks for it already
  if (globalThis[name]) { resolve(); return; }
  const part = document.querySelector(`script[src="${address}"]`);
  part.addEventListener("load", resolve);
  part.addEventListener("error", () => reject(new Error(`${address} cannot be loaded`)));
});
const ready = () => { loading ||= Promise.all([script("/_tiltcal/plotly.js", "Plotly"), script("/_tiltcal/drawing.js", "tiltcalDrawing")]); return loading; };
export default {
  template: `<figure class="figure"><div ref="plot" class="plot" role="img" :aria-label="plot.alternative" :style="{ height: plot.height + 'px' }"></div><figcaption>{{ plot.caption }}</figcaption></figure>`,
  props: { plot: Object, ranged: Boolean },
  async mounted() {
    await ready();
    if (!this.$refs.plot) return;
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.redraw = () => this.draw();
    this.dark.addEventListener("change", this.redraw);
    this.draw();
  },
  unmounted() {
    this.dark?.removeEventListener("change", this.redraw);
    clearTimeout(this.timer);
    if (this.$refs.plot) globalThis.Plotly?.purge(this.$refs.plot);
  },
  methods: {
    draw() {
      const part = this.$refs.plot;
      const shown = JSON.parse(JSON.stringify(this.plot));
      if (this.ranged) shown.layout.dragmode = "pan";
      tiltcalDrawing.draw(part, shown, { scrollZoom: this.ranged });
      part.removeAllListeners?.("plotly_relayout");
      part.on("plotly_relayouting", () => part.classList.add("moving"));
      part.on("plotly_relayout", (change) => { part.classList.remove("moving"); this.moved(change); });
      part.on("plotly_click", (event) => { const at = event.points?.find((point) => point.data.mode === "markers"); if (at) this.$emit("point", { index: at.pointNumber, x: at.x }); });
    },
    moved(change) {
      const band = Object.keys(change).map((key) => /^shapes\[(\d+)\]\.x[01]$/.exec(key)).find(Boolean);
      if (band) { const s = this.$refs.plot.layout.shapes[band[1]]; this.$emit("band", [Number(band[1]), Math.min(s.x0, s.x1), Math.max(s.x0, s.x1)]); return; }
      if (!this.ranged || this.quiet) return;
      if (!Object.keys(change).some((key) => key.startsWith("xaxis"))) return;
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.$emit("range", change["xaxis.autorange"] ? null : [...this.$refs.plot.layout.xaxis.range]), 60);
    },
    show(data) {  // other points of the same series, for the range that is visible
      const part = this.$refs.plot;
      if (!part?.data) return;
      this.quiet = true;
      const rows = data.map((_, k) => k);
      const keys = ["x", "y", "z"].filter((key) => data[0] && data[0][key]);
      Plotly.restyle(part, Object.fromEntries(keys.map((key) => [key, data.map((d) => d[key])])), rows).then(() => { this.quiet = false; });
    },
  },
  watch: { plot() { if (globalThis.tiltcalDrawing && this.$refs.plot) this.draw(); } },
};
