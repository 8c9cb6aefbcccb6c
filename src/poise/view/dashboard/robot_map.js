// Draws the robot: computers with their components, connectors, tables and decisions.
// The server sends only what has changed; what is done goes back as events.

import { routed } from "/poise/routes.js";
import Charts from "/poise/charts.js";

const KINDS = {
  direct: "within a container",
  local: "between containers",
  remote: "between computers",
  unknown: "not known now",
};
const GLYPHS = { seen: "○", decided: "◆", done: "✓", failed: "✗", wrong: "▲", right: "▽" };
const STATES = { active: "", inactive: "⏸ ", unresponsive: "⚠ ", failed: "✗ ", unconfigured: "… " };
const FEW = 12; // rows of a table that is not opened
const LARGE = 60; // of more components only the connectors of one, or of those searched, are drawn
const PATIENCE = 5; // without news for more seconds the page says so

const CLOCK = new Intl.DateTimeFormat([], { timeStyle: "medium", hour12: false });
const percent = (x) => (x === undefined || x === null ? "?" : `${(100 * x).toFixed(x < 0.0995 ? 1 : 0)} %`);
const seconds = (x) => (x === null ? "" : x >= 1 ? `${+x.toPrecision(3)} s` : `${+(1000 * x).toPrecision(3)} ms`);
const bytes = (x) => {
  const units = ["B", "KiB", "MiB", "GiB"];
  let unit = 0;
  for (; x >= 1024 && unit < 3; unit++) x /= 1024;
  return `${+x.toPrecision(3)} ${units[unit]}`;
};
const cores = (x) => `${+x.toFixed(3)} ${x === 1 ? "core" : "cores"}`;
const byName = (records) =>
  Object.entries(records || {})
    .sort(([a], [b]) => (a < b ? -1 : 1))
    .map(([name, each]) => ({ name, ...each }));

const VERBS = { going: ["pause", "cancel"], waiting: ["cancel"], paused: ["resume", "cancel"] };
const SIGNS = { pause: "Pause", resume: "Resume", cancel: "Cancel" };

export default {
  components: { Charts },
  template: `
<div :class="['robot', {stale: !isNow, many: isLarge}]">
  <div class="headline">
    <h1>{{ robot.name || 'no robot yet' }}</h1>
    <span v-if="health" :class="['health', health.kind]">{{ health.says }}</span>
    <label class="find">Find <input type="search" v-model="wanted" aria-label="Find components"></label>
  </div>
  <p v-if="silent" class="trouble">⚠ Nothing has come for {{ silent }} s: the manager is busy, or the link to this page is slow or down.</p>
  <div role="status" aria-live="polite">
    <p v-if="robot.trouble" class="trouble">⚠ No answer since {{ clock(robot.since) }}, trying again<template
      v-if="robot.name">; below is {{ robot.old ? "what was known last" : "what agents report" }}</template>. {{ robot.trouble }}</p>
    <ul v-if="robot.deviations && robot.deviations.length" class="deviations">
      <li v-for="what in robot.deviations.slice(0, 6)">▲ {{ what }}</li>
      <li v-if="robot.deviations.length > 6">and {{ robot.deviations.length - 6 }} more</li>
    </ul>
  </div>
  <template v-if="isNow">
    <p v-for="what in late" class="missed">▲ {{ what }}</p>
    <p v-if="unknown" class="missed">? {{ unknown }}</p>
    <p v-if="fine" class="fine">✓ {{ fine }}</p>
  </template>

  <ul v-if="robot.managed && isNow" class="tasks" aria-label="Tasks">
    <li v-for="task in robot.tasks || []" :class="task.state"><span class="dim">task</span> <b>{{ task.name }}</b> {{ task.state }}<span
      v-if="task.why"> ({{ task.why }})</span><span v-if="task.now.length">: {{ task.now.join(", ") }}</span><span
      v-if="task.waits.length && verbs[task.state]">; waits to begin {{ task.waits.join(", ") }}</span><span
      v-if="task.next.length">; next {{ task.next.join(", ") }}</span>
      <button v-for="verb in verbs[task.state] || []" type="button" class="act" :aria-label="verb + ' task ' + task.name"
        @click="$emit('task', [verb, task.name])">{{ signs[verb] }}</button></li>
    <li v-for="name in startable" class="idle"><button type="button" class="act" :aria-label="'start task ' + name"
      @click="$emit('task', ['start', name])">▶ start {{ name }}</button></li>
  </ul>

  <section aria-label="Computers" class="area" ref="area" @mouseleave="near = null">
    <svg class="wires" aria-hidden="true" :width="size.width" :height="size.height">
      <defs><marker id="tip" viewBox="0 0 8 8" refX="7.5" refY="4" markerWidth="7" markerHeight="7"
        markerUnits="userSpaceOnUse" orient="auto"><path d="M0 0L8 4L0 8Z" fill="context-stroke"/></marker></defs>
      <path v-for="wire in wires" :key="wire.name" :d="wire.d" :class="['wire', wire.kind, {dim: wire.dim, picked: wire.picked, down: !wire.ready}]"
        :stroke-width="wire.width" marker-end="url(#tip)"/>
    </svg>
    <article v-for="computer in computers" :key="computer.name" :aria-label="'computer ' + computer.name"
      :class="['computer', {gone: computer.state, over: over === computer.name}]" :data-computer="computer.name"
      @dragover.prevent="over = computer.name" @dragleave="over = null" @drop.prevent="drop(computer.name)">
      <h2>{{ computer.name }} <small v-if="computer.state">? {{ computer.state }}{{ since(computer) }}</small>
        <small v-else-if="missing(computer)">▲ {{ missing(computer) }}</small></h2>
      <div class="bar" role="img" :aria-label="load(computer)" :title="load(computer)">
        <i class="own" :style="{width: share(computer.used - computer.background, computer)}"></i
        ><i class="other" :style="{width: share(computer.background, computer)}"></i>
        <b v-if="missing(computer)" class="beyond" :style="{left: share(computer.capacity, computer)}"></b>
        <b v-if="computer.need !== null" class="need" :style="{left: share(computer.need - computer.sure, computer), width: share(2 * computer.sure, computer)}"></b>
      </div>
      <p class="load">{{ load(computer) }}</p>
      <ul class="components">
        <li v-for="c in computer.components" :key="c.name">
          <button type="button" draggable="true" :data-component="c.name" :title="near === c.name ? describe(c) : null"
            :class="['component', c.state.replace(' ', '-'), {late: c.late, other: !fits(c.name)}]"
            @dragstart="grab(c.name, $event)" @dragend="over = null" @click="$emit('component', c.name)"
            @mouseenter="near = c.name" @focus="near = c.name" @keydown="step($event)">
            <span class="name">{{ mark(c) }}{{ c.name }}</span>
            <span class="figures">{{ figures(c) }}<b v-if="c.late"> ▲ {{ percent(c.late) }} late</b></span>
            <span class="meter" aria-hidden="true"><i :style="{transform: 'scaleX(' + part(c.cpu, computer) + ')'}"></i></span>
          </button>
        </li>
      </ul>
      <p v-if="!computer.components.length && !computer.state" class="empty">no component runs here</p>
    </article>
  </section>
  <p class="legend"><span v-for="(says, kind) in kinds"><svg width="44" height="10" aria-hidden="true"><path d="M2 5H42"
    :class="['wire', kind]" stroke-width="3"/></svg> {{ kind }}: {{ says }}</span>
    <span>thicker: more traffic</span><span>point at a component: its connectors only</span><b v-if="isLarge">point at a component, or find it, to see its connectors</b>
    <span><i class="swatch own"></i> the robot</span><span><i class="swatch other"></i> other programs</span>
    <span><i class="swatch need"></i> what components need, 95 % sure</span>
    <span><i class="swatch beyond"></i> more than the computer has</span></p>
  <p class="legend">Select a component to read its log, and what a move would change; or drag it to another computer. Arrow keys go
    from one component to the next.</p>

  <div class="lower">
  <charts v-if="parts.history" :moments="parts.history" :entries="entries" :now="now" @entry="$emit('entry', $event)"></charts>
  <section v-if="entries.length" aria-labelledby="decisions">
    <h2 id="decisions">Decisions</h2>
    <ol class="entries">
      <li v-for="e in entries.slice(0, more.entries ? 200 : few)" :key="e.number">
        <button type="button" :title="tell(e)" :class="e.kind" @click="$emit('entry', e.number)"
        ><time>{{ clock(e.at) }}</time> <span>{{ glyphs[e.kind] }} {{ e.kind }}</span> <span>{{ e.what }}</span></button></li>
    </ol>
    <button v-if="entries.length > few" type="button" class="more" @click="more.entries = !more.entries"
    >{{ more.entries ? 'fewer' : 'all ' + entries.length }} decisions</button>
  </section>
  </div>

  <section v-for="t in tables" :key="t.name" :aria-labelledby="t.name">
    <h2 :id="t.name">{{ t.title }}</h2>
    <div class="scroll" tabindex="0" role="group" :aria-label="t.title + ', scrolls'"><table>
      <thead><tr><th v-for="h in t.heads" scope="col">{{ h }}</th></tr></thead>
      <tbody><tr v-for="row in t.rows.slice(0, more[t.name] ? 1000 : few)" :key="row.cells[0]" :class="{late: row.bad}">
        <td v-for="cell in row.cells">{{ cell }}</td></tr></tbody>
    </table></div>
    <button v-if="t.rows.length > few" type="button" class="more" @click="more[t.name] = !more[t.name]"
    >{{ more[t.name] ? 'fewer' : 'all ' + t.rows.length }} {{ t.title.toLowerCase() }}</button>
  </section>
</div>`,

  data: () => ({
    parts: {}, now: 0, silent: 0, wanted: "", near: null, over: null, more: {},
    size: { width: 0, height: 0 }, kinds: KINDS, glyphs: GLYPHS, few: FEW, verbs: VERBS, signs: SIGNS, ways: {},
  }),

  computed: {
    // Whether what is shown is so now, not what was known last.
    isNow() { return !this.robot.trouble && !this.silent; },
    robot() { return (this.parts.robot || {})[""] || {}; },
    isLarge() { return this.components.length > LARGE; },
    components() { return byName(this.parts.components); },
    computers() {
      const here = {};
      for (const each of this.components) (here[each.at] ||= []).push(each);
      return byName(this.parts.computers).map((computer) => ({
        ...computer,
        components: (here[computer.name] || []).sort((a, b) => (a.in < b.in ? -1 : a.in > b.in ? 1 : 0)),
      }));
    },
    layout() { return this.computers.map((c) => [c.name, c.state, c.components.map((each) => each.name)].join()).join(";"); },
    connectors() { return byName(this.parts.connectors); },
    wires() {
      const drawn = this.connectors.map((wire) => this.wire(wire)).filter((wire) => wire.d && (wire.picked || !this.isLarge));
      return drawn.sort((a, b) => a.picked - b.picked); // those that are picked lie on top
    },
    wiring() { return this.connectors.map((c) => [c.name, c.kind]).join(";") + this.layout + this.size.width; },
    startable() {
      const going = (this.robot.tasks || []).filter((task) => VERBS[task.state]).map((task) => task.name);
      return (this.robot.startable || []).filter((name) => !going.includes(name));
    },
    health() {
      if (!this.robot.name) return null;
      if (!this.isNow) return { kind: "bad", says: this.robot.trouble ? "? no answer" : "? no news" };
      const wrong = (this.robot.deviations || []).length;
      if (wrong) return { kind: "bad", says: `▲ ${wrong} ${wrong === 1 ? "thing is" : "things are"} wrong` };
      return { kind: "good", says: "✓ everything runs as the robot file says" };
    },
    // Of how much nothing is known now: it is neither late nor in time.
    unknown() {
      const several = [["timer", byName(this.parts.timers).filter((t) => t.deadline)], ["chain", byName(this.parts.chains)]];
      const parts = several.map(([noun, all]) => [noun, all.filter((each) => !each.known).length, all.length])
        .filter(([, count]) => count).map(([noun, count, all]) => `${count} of ${all} ${noun}s`);
      return parts.length ? `nothing is known now of ${parts.join(" and ")}` : "";
    },
    fine() {
      if (!this.parts.timers || this.late.length || this.unknown) return "";
      const timers = byName(this.parts.timers).filter((t) => t.deadline).length, chains = byName(this.parts.chains);
      const idle = chains.filter((c) => c.now === null).length;
      const counted = (count, noun) => count && `${count} ${noun}${count === 1 ? "" : "s"}`;
      const parts = [counted(timers, "timer"), counted(chains.length - idle, "chain")].filter(Boolean).join(" and ");
      return parts && `no deadline is missed: ${parts}${idle ? `; data of ${counted(idle, "chain")} was not used lately` : ""}`;
    },
    late() {
      const timers = byName(this.parts.timers).filter((t) => t.deadline), chains = byName(this.parts.chains);
      const missing = timers.filter((t) => t.known && t.now > 0).sort((a, b) => b.now - a.now);
      const old = chains.filter((c) => c.now > 0).sort((a, b) => b.now - a.now);
      const worst = (several, tell) => several.slice(0, 3).map(tell).join(", ");
      return [
        missing.length && `${missing.length} of ${timers.length} timers miss deadlines now: ${worst(missing, (t) => `${t.name} ${percent(t.now)}`)}`,
        old.length && `the data of ${old.length} of ${chains.length} chains is too old now: ${worst(old, (c) => `${c.name} ${percent(c.now)}`)}`,
      ].filter(Boolean);
    },
    entries() { return Object.values(this.parts.entries || {}).sort((a, b) => b.number - a.number); },
    tables() {
      const worst = (a, b) => (b.now || 0) - (a.now || 0) || b.missed / b.releases - a.missed / a.releases;
      const rows = (part) => byName(this.parts[part]).filter((each) => this.fits(each.name));
      return [
        { name: "timers", title: "Timers", heads: ["timer", "rate", "deadline", "late now", "late in all", "takes (p99)"],
          rows: rows("timers").sort(worst).map((t) => ({ bad: t.now > 0 && t.deadline, cells: [
            t.name, `${+(1 / t.period).toPrecision(3)} Hz`, t.deadline ? seconds(t.deadline) : "none",
            t.deadline ? (t.now > 0 ? "▲ " : "") + (t.known ? percent(t.now) : "not known") : "", t.deadline ? `${t.missed} of ${t.releases}` : "", seconds(t.p99)] })) },
        { name: "chains", title: "Chains", heads: ["chain", "deadline", "age (median)", "age (p99)", "late", "age at each component"],
          rows: rows("chains").map((c) => ({ bad: c.now > 0 || c.p99 > c.deadline, cells: [
            c.name, seconds(c.deadline), seconds(c.median), (c.p99 > c.deadline ? "▲ " : "") + seconds(c.p99), `${c.missed} of ${c.uses}${c.now !== null ? "" : c.known ? ", not used now" : ", not known now"}`,
            c.hops.map(([name, age]) => `${name} ${seconds(age)}`.trim()).join(" → ")] })) },
        { name: "connectors", title: "Connectors", heads: ["connector", "kind", "a second", "traffic", "dropped", "errors"],
          rows: rows("connectors").sort((a, b) => b.rate - a.rate).map((c) => ({ bad: c.drops || c.errors || !c.ready, cells: [
            c.name, c.kind === "unknown" ? "not known" : c.kind + (c.ready ? "" : " ⚠ not joined"), c.rate ?? "?",
            c.bytes ? `${bytes(c.bytes)}/s` : "", c.drops, c.errors] })) },
      ].filter((t) => t.rows.length);
    },
  },

  watch: {
    near() { if (this.isLarge) this.route(); },
    wanted() { if (this.isLarge) this.route(); },
    layout() { this.$nextTick(this.measure); },
    wiring() { this.$nextTick(this.route); },
  },
  mounted() {
    this.observer = new ResizeObserver(() => this.measure());
    this.observer.observe(this.$refs.area);
    this.taken = performance.now();
    this.ticker = setInterval(() => {
      const waited = (performance.now() - this.taken) / 1000;
      this.silent = waited > PATIENCE ? Math.round(waited) : 0;
    }, 1000);
  },
  unmounted() {
    this.observer.disconnect();
    clearInterval(this.ticker);
  },

  methods: {
    percent,
    // Takes what has changed; says so, so that a slow link gets fewer updates.
    show(changes, now, isWhole) {
      this.$emit("taken");
      if (isWhole) this.parts = {};
      for (const [part, records] of Object.entries(changes)) {
        const known = { ...this.parts[part], ...records };
        for (const name in records) if (records[name] === null) delete known[name];
        this.parts[part] = Object.freeze(known); // Vue watches nothing inside: that takes long
      }
      this.now = now;
      this.taken = performance.now();
      this.silent = 0;
    },
    measure() {
      const area = this.$refs.area, at = area.getBoundingClientRect();
      const place = (element) => {
        const box = element.getBoundingClientRect();
        return { left: box.left - at.left, right: box.right - at.left, top: box.top - at.top, bottom: box.bottom - at.top };
      };
      this.cards = [...area.querySelectorAll("[data-computer]")].map((card) => ({
        ...place(card),
        boxes: [...card.querySelectorAll("[data-component]")].map((box) => ({ name: box.dataset.component, ...place(box) })),
      }));
      this.size = { width: at.width, height: at.height };
      this.route();
    },
    // Of a large robot only what is pointed at or searched gets a way.
    route() {
      const wanted = this.isLarge ? this.connectors.filter((wire) => this.isPicked(wire)) : this.connectors;
      this.ways = Object.freeze(routed(this.cards || [], wanted));
    },
    isPicked({ source, target }) {
      const isNear = this.near === source || this.near === target;
      return isNear || !!this.wanted && (this.fits(source) || this.fits(target));
    },
    wire(each) {
      const picked = this.isPicked(each);
      return {
        ...each, picked, d: this.ways[each.name], dim: (this.near || this.wanted) && !picked,
        width: Math.min(5, Math.round(3 + 1.3 * Math.log10(1 + (each.bytes || 20 * (each.rate || 0)) / 100)) / 2),
      };
    },
    fits(name) { return !this.wanted || name.toLowerCase().includes(this.wanted.toLowerCase()); },
    part(amount, computer) {
      const whole = Math.max(computer.capacity || 0, computer.used || 0, computer.need + computer.sure, 0.001);
      return Math.min(1, Math.max(0, (amount || 0) / whole)).toFixed(3);
    },
    share(amount, computer) { return `${100 * this.part(amount, computer)}%`; },
    since(c) { return c.age ? `, last news ${c.age} s ago` : ""; },
    figures(c) {
      if (c.state === "unknown") return c.cpu === undefined ? "?" : `? (${percent(c.cpu)} before)`;
      return c.state === "inactive" ? "inactive" : percent(c.cpu);
    },
    load(c) {
      if (c.state) return `how it is now is not known${this.since(c)}`;
      const used = c.capacity && c.used !== undefined ? `${percent(c.used / c.capacity)} of ${cores(c.capacity)} used` : "use not known";
      const other = c.background ? `, ${percent(c.background / c.capacity)} by other programs` : "";
      const need = c.need === null ? "what components need is not known" : `components need ${cores(c.need)} ± ${+c.sure.toFixed(3)}`;
      return `${used}${other}; ${need}; ${bytes(c.memory)}`;
    },
    missing(c) {
      const short = c.need - (c.capacity - (c.background || 0));
      return short > Math.max(c.sure, 0.01) ? `${cores(short)} too little` : "";
    },
    mark(c) { return c.errors || c.hung ? "⚠ " : STATES[c.state] ?? "? "; },
    describe(c) {
      const sure = c.sure === undefined || c.sure === null ? "" : ` ± ${percent(c.sure)}`;
      return [`${c.name}: ${c.state}`, c.in && `in ${c.in}`, c.cpu !== undefined && `needs ${percent(c.cpu)}${sure} of a core`,
        c.starved > 0 && `starved ${percent(c.starved)}`, c.late && `${percent(c.late)} of deadlines missed now`,
        c.errors && `${c.errors} errors: ${c.error}`, c.hung && `hangs for ${c.hung} s`].filter(Boolean).join(", ");
    },
    tell(e) { return e.why ? `${e.what}\n${e.why}` : e.what; },
    clock(at) { return CLOCK.format(1000 * at); },
    grab(name, event) {
      event.dataTransfer.setData("text/plain", name);
      this.near = this.held = name;
    },
    drop(computer) {
      this.over = null;
      if (this.held && this.parts.components[this.held].at !== computer) this.$emit("what_if", [this.held, computer]);
      this.held = null;
    },
    step(event) {
      const to = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (!to) return;
      event.preventDefault();
      const all = [...this.$refs.area.querySelectorAll("[data-component]")];
      all[(all.indexOf(event.target) + to + all.length) % all.length].focus();
    },
  },
};
