// The averaged responses at a chosen channel, plotted by uPlot.

const USUAL = ["Fz", "FCz", "Cz"]; // the first of these that is there is shown first: the paper shows Fz
const WAIT_MS = 1000; // between two averages that are asked for

export class Responses {
  constructor(place, select, told, onChoice) {
    Object.assign(this, { place, select, told, onChoice, channel: null, version: -1, askedAt: 0, plot: null, last: null });
    select.addEventListener("change", () => this.choose(select.value));
    const redraw = () => this.last && this.draw(this.last, true);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
    new ResizeObserver(() => this.plot?.setSize(this.size())).observe(place);
  }

  size() { return { width: Math.max(200, this.place.clientWidth), height: Math.max(120, this.place.clientHeight) }; }

  /** Another channel from now on. */
  choose(channel) {
    this.channel = this.select.value = channel;
    this.version = -1;
    this.onChoice();
    this.ask();
  }

  /** What the console says of the averages: which channels there are, and how many epochs are in them. */
  update({ channels, version, left_out: leftOut }) {
    const names = channels.filter((name) => !/eog/i.test(name));
    if (names.length !== this.select.options.length || names.some((name, index) => this.select.options[index].value !== name)) {
      this.select.replaceChildren(...names.map((name) => new Option(name, name)));
      const first = names.includes(this.channel) ? this.channel : USUAL.find((name) => names.includes(name)) ?? names[0];
      if (first) this.choose(first);
    }
    this.leftOut = leftOut;
    this.newest = version;
    if (version !== this.version) this.ask();
  }

  async ask() {
    if (!this.channel || this.waits) return;
    this.waits = true;
    await new Promise((done) => setTimeout(done, Math.max(0, this.askedAt + WAIT_MS - performance.now())));
    this.waits = false;
    this.askedAt = performance.now();
    this.version = this.newest ?? -1;
    const answer = await fetch(`average?channel=${encodeURIComponent(this.channel)}`).catch(() => null);
    if (!answer?.ok) return;
    this.draw(await answer.json(), false);
    if (this.newest !== this.version) this.ask();
  }

  draw(average, anew) {
    this.last = average;
    this.told.textContent = `${average.n.error} errors, ${average.n.correct} correct${this.leftOut ? `, ${this.leftOut} left out` : ""}`;
    const none = average.times_ms.map(() => null);
    const data = [average.times_ms, ...["error", "correct", "difference"].map((name) => average[name] ?? none)];
    if (anew) { this.plot?.destroy(); this.plot = null; }
    if (this.plot) this.plot.setData(data);
    else this.plot = new uPlot(this.options(), data, this.place);
    this.place.dataset.n = String(average.n.error + average.n.correct);
  }

  options() {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const axis = { stroke: colour("soft"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("grid"), width: 1 } };
    const curve = (label, name, width, dash) => ({ label, stroke: colour(name), width, dash, points: { show: false } });
    return {
      ...this.size(),
      legend: { show: false },
      cursor: { y: false },
      scales: { x: { time: false }, y: { range: (_, low, high) => (low === null ? [-5, 5] : uPlot.rangeNum(low, high, 0.1, true)) } },
      axes: [{ ...axis, label: "ms from the move", labelSize: 20, size: 34 }, { ...axis, label: "µV", labelSize: 18, size: 44 }],
      series: [{}, curve("error", "error", 2), curve("correct", "correct", 2, [7, 4]), curve("difference", "difference", 2, [2, 3])],
      hooks: { draw: [(plot) => zeroLine(plot, colour("soft"))] },
    };
  }
}

/** The move itself. */
function zeroLine(plot, colour) {
  const x = plot.valToPos(0, "x", true);
  plot.ctx.save();
  plot.ctx.strokeStyle = colour;
  plot.ctx.setLineDash([]);
  plot.ctx.beginPath();
  plot.ctx.moveTo(x, plot.bbox.top);
  plot.ctx.lineTo(x, plot.bbox.top + plot.bbox.height);
  plot.ctx.stroke();
  plot.ctx.restore();
}
