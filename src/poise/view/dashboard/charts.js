// Draws how loads, ages and misses were over the last ten minutes, with decisions marked.

const SPAN = 600; // [s]
const [WIDTH, HEIGHT, TOP] = [1000, 100, 6];
const GAP = 3; // a line goes on over so many seconds without a figure
const APART = 12; // [s] between two marks of a row
const ROWS = 6; // of marks; where more come together, the last ones are on top
const MOST = 8; // lines of a chart; of more, those that were highest
const MARKED = { decided: "◆", failed: "✗", wrong: "▲", right: "▽" };

export default {
  props: ["moments", "entries", "now"],
  emits: ["entry"],
  template: `
<section aria-labelledby="history" class="history" @mouseleave="at = null">
  <h2 id="history">The last ten minutes</h2>
  <p v-if="begin" class="dim">Known since {{ begin }}, when this dashboard began to look.</p>
  <div class="marks" aria-hidden="true" :style="{height: 1.2 * rows + 'rem'}"><button v-for="e in marks" :key="e.number" type="button" tabindex="-1"
    :class="['moment', e.kind]" :style="{left: e.x + '%', top: 1.2 * e.row + 'rem'}" :title="e.title" @click="$emit('entry', e.number)">{{ e.glyph }}</button></div>
  <figure v-for="chart in charts" :key="chart.title">
    <figcaption><b>{{ chart.title }}</b>
      <span v-for="line in chart.lines" class="key"><i :style="{background: line.colour}"></i>{{ line.name }}
        <b>{{ line.said }}</b></span>
      <span v-if="chart.more" class="dim">and {{ chart.more }} lower ones</span></figcaption>
    <div class="plot" @mousemove="point($event)">
      <svg viewBox="0 0 ${WIDTH} ${HEIGHT}" preserveAspectRatio="none" role="img" :aria-label="chart.says">
        <rect v-if="chart.limit" x="0" y="0" width="${WIDTH}" :height="chart.limit" class="beyond-limit"/>
        <line v-if="chart.limit" x1="0" x2="${WIDTH}" :y1="chart.limit" :y2="chart.limit" class="limit"/>
        <line v-for="e in marks" :x1="10 * e.x" :x2="10 * e.x" y1="0" y2="${HEIGHT}" :class="['mark', e.kind]"/>
        <path v-for="line in chart.lines" :d="line.d" :stroke="line.colour" class="line"/>
        <line v-if="at !== null" :x1="10 * at" :x2="10 * at" y1="0" y2="${HEIGHT}" class="cursor"/>
      </svg>
      <span class="most">{{ chart.top }}</span>
    </div>
  </figure>
  <p class="axis" aria-hidden="true"><span v-for="n in [10, 8, 6, 4, 2, 0]">{{ n ? n + ' min ago' : 'now' }}</span></p>
</section>`,
  data: () => ({ at: null }),
  computed: {
    // Those of the last ten minutes: others are there while no news comes, and after the clock was set.
    seconds() {
      return Object.entries(this.moments || {}).map(([second, each]) => [+second, each])
        .filter(([second]) => second > this.now - SPAN && second <= this.now).sort((a, b) => a[0] - b[0]);
    },
    begin() {
      const first = this.seconds[0]?.[0];
      return first && this.now - first < SPAN - 5 ? new Date(1000 * first).toTimeString().slice(0, 8) : "";
    },
    // What comes soon after something else is drawn below it, so that each can be clicked.
    marks() {
      const ends = [];
      return this.entries.filter((e) => MARKED[e.kind] && e.at > this.now - SPAN).reverse().map((e) => {
        let row = ends.findIndex((end) => e.at > end + APART);
        if (row < 0) row = ends.length < ROWS ? ends.length : ends.indexOf(Math.min(...ends));
        ends[row] = e.at;
        return { ...e, row, x: this.x(e.at), glyph: MARKED[e.kind], title: e.why ? `${e.what}\n${e.why}` : e.what };
      });
    },
    rows() { return 1 + Math.max(0, ...this.marks.map((e) => e.row)); },
    charts() {
      const several = [
        this.chart("CPU used, of what a computer has", "cpu", 1),
        this.chart("Age of data when it was used, of its deadline", "ages", 1),
        this.chart("Deadlines that the worst timer misses", "late", 0),
      ];
      return several.filter((chart) => chart.lines.length);
    },
  },
  methods: {
    x(second) { return Math.max(0, Math.min(100, (100 * (second - this.now + SPAN)) / SPAN)); },
    point(event) {
      const box = event.currentTarget.getBoundingClientRect();
      this.at = (100 * (event.clientX - box.left)) / box.width;
    },
    // The lines of a part of the moments; `limit` is drawn, unless it is 0.
    chart(title, part, limit) {
      const lines = {};
      for (const [second, moment] of this.seconds) {
        const values = part === "late" ? { "the worst": moment.late } : moment[part];
        for (const name in values) (lines[name] ||= []).push([second, values[name]]);
      }
      const highest = (points) => Math.max(...points.map(([, value]) => value ?? 0));
      const ordered = Object.entries(lines).sort((a, b) => highest(b[1]) - highest(a[1]));
      const shown = ordered.slice(0, MOST).sort((a, b) => (a[0] < b[0] ? -1 : 1));
      const top = Math.max(limit ? 1.2 : 0.1, ...shown.map(([, points]) => highest(points)));
      const y = (value) => HEIGHT - ((HEIGHT - TOP) * value) / top;
      return {
        title, top: `${Math.round(100 * top)} %`, more: ordered.length - shown.length, limit: limit && y(limit),
        says: shown.map(([name, points]) => `${name} ${this.said(points)}`).join(", "),
        lines: shown.map(([name, points], i) => ({
          name, colour: `var(--series-${i + 1})`, said: this.said(points), d: this.path(points, y),
        })),
      };
    },
    // The value under the pointer, else the last one.
    said(points) {
      const second = this.at === null ? this.now : this.now - SPAN + (SPAN * this.at) / 100;
      const near = points.filter(([at]) => Math.abs(at - second) <= (this.at === null ? 5 : 2)).at(-1);
      return near && near[1] !== null ? `${Math.round(100 * near[1])} %` : "not known";
    },
    path(points, y) {
      let d = "", before = -Infinity;
      for (const [second, value] of points) {
        if (value === null) continue;
        d += `${second - before > GAP ? "M" : "L"}${(10 * this.x(second)).toFixed(1)} ${y(value).toFixed(1)}`;
        before = second;
      }
      return d;
    },
  },
};
