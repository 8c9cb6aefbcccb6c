// Finds ways for connectors through the gaps between boxes: right angles, never behind a box.

const BEND = 14; // a corner is as dear as so many pixels
const SHARED = 0.75; // a stretch that others use is cheaper: so connectors form bundles
const MARGIN = 9; // how far outside the outermost computers the outermost way lies
const ROUND = 5; // the radius of a corner
const OFFSETS = { direct: -5, local: 0, remote: 5 }; // kinds lie beside each other [pixels]

// cards: [{left, top, right, bottom, boxes: [{name, left, top, right, bottom}]}];
// wires: [{name, source, target, kind}]. Returns the path of each wire by name.
export function routed(cards, wires) {
  const ways = new Ways(cards.filter((card) => card.boxes.length));
  const found = {};
  for (const wire of [...wires].sort((a, b) => ways.span(a) - ways.span(b))) {
    const points = ways.find(wire.source, wire.target);
    if (points) found[wire.name] = path(points, OFFSETS[wire.kind] ?? 0);
  }
  return found;
}

const middles = (starts, ends) => starts.slice(1).map((start, i) => (ends[i] + start) / 2);
const unique = (numbers) =>
  numbers.sort((a, b) => a - b).filter((each, i, all) => !i || each - all[i - 1] > 3);

// Returns the lines between rows or columns of boxes, with one before and one after.
function lines(boxes, from, to, before, after) {
  const starts = unique(boxes.map((box) => box[from]));
  const ends = starts.map((start) =>
    Math.max(...boxes.filter((box) => Math.abs(box[from] - start) <= 3).map((box) => box[to])));
  const gaps = middles(starts, ends).filter((at) => !boxes.some((box) => box[from] < at && at < box[to]));
  return [before(starts[0]), ...gaps, after(Math.max(...ends))];
}

class Ways {
  constructor(cards) {
    this.ports = {}; // box -> its two sides: {x, y, node}
    this.nodes = []; // {x, y, next: [{to, length, isFlat, key}]}
    this.known = new Map();
    this.used = new Set();
    this.middle = {};
    const outer = {
      x: lines(cards, "left", "right", (x) => x - MARGIN, (x) => x + MARGIN),
      y: lines(cards, "top", "bottom", (y) => y - MARGIN, (y) => y + MARGIN),
    };
    const upright = outer.x.map((x) => ({ x, ys: [...outer.y] }));
    const flat = outer.y.map((y) => ({ y, xs: [...outer.x] }));
    for (const card of cards) this.addCard(card, outer, upright, flat);
    for (const line of upright) this.join(unique(line.ys).map((y) => this.node(line.x, y)), 0);
    for (const line of flat) this.join(unique(line.xs).map((x) => this.node(x, line.y)), 1);
  }

  addCard(card, outer, upright, flat) {
    const left = Math.max(...outer.x.filter((x) => x < card.left));
    const right = Math.min(...outer.x.filter((x) => x > card.right));
    const gap = 8;
    const xs = lines(card.boxes, "left", "right", (x) => x - gap, (x) => x + gap);
    const ys = lines(card.boxes, "top", "bottom", (y) => y - gap, (y) => y + gap);
    const columns = xs.map((x) => ({ x, ys: [...ys] }));
    upright.push(...columns);
    for (const y of ys) flat.push({ y, xs: [left, ...xs, right] });
    for (const x of [left, right]) upright.find((line) => line.x === x).ys.push(...ys);
    for (const box of card.boxes) {
      const y = (box.top + box.bottom) / 2;
      const near = [columns.filter((c) => c.x < box.left).at(-1), columns.find((c) => c.x > box.right)];
      this.middle[box.name] = [(box.left + box.right) / 2, y];
      this.ports[box.name] = near.map((column, side) => {
        column.ys.push(y);
        return { x: side ? box.right : box.left, y, column };
      });
    }
  }

  node(x, y) {
    const key = `${Math.round(x)},${Math.round(y)}`;
    if (!this.known.has(key)) this.known.set(key, this.nodes.push({ x, y, next: [] }) - 1);
    return this.known.get(key);
  }

  join(line, isFlat) {
    for (let i = 1; i < line.length; i++) {
      const [a, b] = [line[i - 1], line[i]], one = this.nodes[a], two = this.nodes[b];
      const length = Math.abs(one.x - two.x) + Math.abs(one.y - two.y), key = `${a}-${b}`;
      one.next.push({ to: b, length, isFlat, key });
      two.next.push({ to: a, length, isFlat, key });
    }
  }

  span({ source, target }) {
    const [a, b] = [this.middle[source], this.middle[target]];
    return a && b ? Math.abs(a[0] - b[0]) + Math.abs(a[1] - b[1]) : 0;
  }

  // The cheapest way (Dijkstra over nodes and directions): its corners, from side to side of the boxes.
  find(source, target) {
    if (!this.ports[source] || !this.ports[target] || source === target) return null;
    const ends = new Map(this.ports[target].map((p) => [this.node(p.column.x, p.y), p]));
    const states = new Array(2 * this.nodes.length), queue = new Queue();
    const reach = (cost, node, isFlat, before, stretch, start) => {
      const key = 2 * node + isFlat;
      if (states[key] && states[key].cost <= cost) return;
      states[key] = { cost, node, isFlat, before, stretch, start };
      queue.add(cost, states[key]);
    };
    for (const p of this.ports[source])
      reach(Math.abs(p.x - p.column.x), this.node(p.column.x, p.y), 1, null, "", p);
    for (let state; (state = queue.take()); ) {
      if (states[2 * state.node + state.isFlat] !== state) continue; // there is a cheaper one
      if (ends.has(state.node)) {
        if (state.isFlat) return this.corners(state, ends.get(state.node));
        reach(state.cost + BEND, state.node, 1, state, "");
      }
      for (const { to, length, isFlat, key } of this.nodes[state.node].next) {
        const cost = length * (this.used.has(key) ? SHARED : 1) + (isFlat === state.isFlat ? 0 : BEND);
        reach(state.cost + cost, to, isFlat, state, key);
      }
    }
    return null;
  }

  corners(state, end) {
    const points = [[end.x, end.y]];
    for (; state; state = state.before) {
      points.push([this.nodes[state.node].x, this.nodes[state.node].y]);
      if (state.stretch) this.used.add(state.stretch);
      if (state.start) points.push([state.start.x, this.nodes[state.node].y]);
    }
    return straight(points.reverse());
  }
}

class Queue {
  constructor() { this.heap = []; }
  add(cost, value) {
    const heap = this.heap;
    let i = heap.push([cost, value]) - 1;
    for (; i && heap[(i - 1) >> 1][0] > heap[i][0]; i = (i - 1) >> 1)
      [heap[i], heap[(i - 1) >> 1]] = [heap[(i - 1) >> 1], heap[i]];
  }
  take() {
    const heap = this.heap, first = heap[0], last = heap.pop();
    if (heap.length && first) {
      heap[0] = last;
      for (let i = 0; ; ) {
        let least = i;
        for (const child of [2 * i + 1, 2 * i + 2])
          if (child < heap.length && heap[child][0] < heap[least][0]) least = child;
        if (least === i) break;
        [heap[i], heap[least]] = [heap[least], heap[i]];
        i = least;
      }
    }
    return first?.[1];
  }
}

// Without the points at which nothing turns.
function straight(points) {
  const same = ([ax, ay], [bx, by]) => ax === bx && ay === by;
  const distinct = points.filter((point, i) => !i || !same(point, points[i - 1]));
  return distinct.filter(([x, y], i) => {
    const [before, after] = [distinct[i - 1], distinct[i + 1]];
    const isBetween = (axis, at) => before[axis] === at && after[axis] === at;
    return !before || !after || !(isBetween(0, x) || isBetween(1, y));
  });
}

function path(points, offset) {
  const last = points.length - 1;
  const moved = points.map(([x, y], i) => [i === 0 || i === last ? x : x + offset, y + offset]);
  let d = `M${moved[0].join(" ")}`;
  for (let i = 1; i < last; i++) {
    const [[ax, ay], [x, y], [bx, by]] = [moved[i - 1], moved[i], moved[i + 1]];
    const r = Math.min(ROUND, (Math.abs(x - ax) + Math.abs(y - ay)) / 2, (Math.abs(bx - x) + Math.abs(by - y)) / 2);
    const [ix, iy] = [x + r * Math.sign(ax - x), y + r * Math.sign(ay - y)];
    const [ox, oy] = [x + r * Math.sign(bx - x), y + r * Math.sign(by - y)];
    d += `L${ix} ${iy}Q${x} ${y} ${ox} ${oy}`;
  }
  return `${d}L${moved[last].join(" ")}`;
}
