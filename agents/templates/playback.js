"use strict";
// Plays back a drive: one scrubber for the view from above, the wheels from the side and all charts.
// Charts share their stretch of time: drag across one to zoom all, double-click to see the whole again.
(() => {
  const INK = "#1c2126", QUIET = "#5b6670", GRID = "#e4e8eb", SOIL = "#d8c3a5", DEEP = "#b08d62";
  const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#8a6d00", "#56B4E9"];
  const LEFT = 52, RIGHT = 10, TOP = 8, BOTTOM = 22;
  const FONT = "12px system-ui, sans-serif";

  const make = (tag, parent, attributes = {}) => {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    parent.append(element);
    return element;
  };
  const known = value => value !== null && value !== undefined;
  const show = value => known(value) ? Number(value.toPrecision(3)).toString() : "–";

  // A canvas as sharp as the screen, cleared, with CSS pixels as its unit.
  const ready = canvas => {
    const scale = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    if (canvas.width !== Math.round(w * scale)) canvas.width = Math.round(w * scale);
    if (canvas.height !== Math.round(h * scale)) canvas.height = Math.round(h * scale);
    const pen = canvas.getContext("2d");
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.font = FONT;
    pen.lineJoin = "round";
    return [pen, w, h];
  };

  // Round numbers between two limits, about `count` of them.
  const ticks = (low, high, count) => {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find(factor => factor * power >= raw);
    const found = [];
    for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(i * step);
    return [found, step];
  };
  const label = (value, step) => value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));

  const stroke = (pen, points) => {
    pen.beginPath();
    let down = false;
    for (const [x, y] of points) {
      if (y === null) { down = false; continue; }
      if (down) pen.lineTo(x, y); else pen.moveTo(x, y);
      down = true;
    }
    pen.stroke();
  };

  class Playback {
    constructor(box) {
      this.box = box;
      this.data = JSON.parse(box.querySelector("script").textContent);
      this.index = 0;
      this.whole = [0, Math.max(this.data.t[this.data.t.length - 1], 1e-6)];
      this.zoom = this.whole.slice();
      this.bar();
      this.views = [];
      const stage = make("div", box, { class: "stage" });
      if (this.data.above) this.add(stage, "above", "from above", () => this.drawAbove());
      if (this.data.wheels.length) this.add(stage, "wheels", "wheels from the side", () => this.drawWheels());
      this.charts = this.data.charts.map(chart => this.chart(chart));
      new ResizeObserver(() => this.draw()).observe(box);
      this.go(0);
    }

    bar() {
      const bar = make("div", this.box, { class: "bar" });
      this.button = make("button", bar, { type: "button", "aria-label": "play or stop" });
      this.button.textContent = "▶";
      this.button.onclick = () => this.play(!this.playing);
      this.slider = make("input", bar, {
        type: "range", min: 0, max: this.data.t.length - 1, step: 1, value: 0, "aria-label": "time",
      });
      this.slider.oninput = () => this.go(Number(this.slider.value));
      this.time = make("output", bar);
      const line = make("p", this.box, { class: "where" });
      this.where = make("span", line);
      if (this.data.above) {
        const choice = make("label", line);
        this.near = make("input", choice, { type: "checkbox" });
        choice.append(" close to the vehicle");
        this.near.onchange = () => this.draw();
      }
      const reset = make("button", line, { type: "button", class: "reset" });
      reset.textContent = "whole time";
      reset.onclick = () => this.setZoom(this.whole);
    }

    add(parent, name, title, draw) {
      const figure = make("div", parent, { class: "view" });
      make("div", figure, { class: "name" }).textContent = title;
      this[name] = make("canvas", figure, { class: name, role: "img", "aria-label": title });
      this.views.push(draw);
    }

    play(on) {
      this.playing = on;
      this.button.textContent = on ? "❚❚" : "▶";
      if (!on) return;
      if (this.index === this.data.t.length - 1) this.go(0);
      const begin = performance.now(), from = this.data.t[this.index];
      const step = now => {
        if (!this.playing) return;
        const t = from + (now - begin) / 1000, last = this.data.t.length - 1;
        let i = this.index;
        while (i < last && this.data.t[i + 1] <= t) i++;
        this.go(i);
        if (i === last) this.play(false); else requestAnimationFrame(step);
      };
      requestAnimationFrame(step);
    }

    go(index) {
      this.index = index;
      this.slider.value = index;
      this.time.textContent = `${this.data.t[index].toFixed(1)} s of ${this.whole[1].toFixed(1)} s`;
      const place = this.data.above;
      this.where.textContent = place ? `x ${show(place.x[index])} m, y ${show(place.y[index])} m ` : "";
      this.draw();
    }

    setZoom(limits) {
      this.zoom = limits.slice();
      this.draw();
    }

    draw() {
      for (const draw of this.views) draw();
      for (const chart of this.charts) this.drawChart(chart);
    }

    // ---------------------------------------------------------------- from above

    drawAbove() {
      const [pen, w, h] = ready(this.above), a = this.data.above, i = this.index;
      const all = [...(a.path || []), ...a.x.map((x, k) => [x, a.y[k]])].filter(p => known(p[0]) && known(p[1]));
      let limits = [Infinity, -Infinity, Infinity, -Infinity];
      for (const [x, y] of all) {
        limits = [Math.min(limits[0], x), Math.max(limits[1], x), Math.min(limits[2], y), Math.max(limits[3], y)];
      }
      if (this.near.checked) limits = [a.x[i] - 15, a.x[i] + 15, a.y[i] - 8, a.y[i] + 8];
      const room = 16 + (this.near.checked ? 0 : a.corridor);
      const scale = Math.min(
        (w - 2 * room) / Math.max(limits[1] - limits[0], 5), (h - 2 * room) / Math.max(limits[3] - limits[2], 5));
      const X = x => w / 2 + scale * (x - (limits[0] + limits[1]) / 2);
      const Y = y => h / 2 - scale * (y - (limits[2] + limits[3]) / 2);
      const way = points => points.map(([x, y]) => [X(x), Y(y)]);
      pen.lineCap = "butt";
      if (a.path && a.corridor > 0) {
        pen.strokeStyle = "#efe6d8";
        pen.lineWidth = Math.max(2 * a.corridor * scale, 6);
        stroke(pen, way(a.path));
        pen.strokeStyle = DEEP;
        for (const stretch of a.stretches) stroke(pen, way(stretch.points));
      }
      if (a.path) {
        pen.strokeStyle = QUIET; pen.lineWidth = 1; pen.setLineDash([4, 4]);
        stroke(pen, way(a.path));
        pen.setLineDash([]);
      }
      const driven = a.x.map((x, k) => known(x) && known(a.y[k]) ? [X(x), Y(a.y[k])] : [0, null]);
      pen.strokeStyle = "#9cc3dc"; pen.lineWidth = 1.5;
      stroke(pen, driven);
      pen.strokeStyle = COLOURS[0]; pen.lineWidth = 3;
      stroke(pen, driven.slice(0, i + 1));
      this.vehicle(pen, X(a.x[i]), Y(a.y[i]), a.yaw[i] || 0, Math.max(3.5 * scale, 20));
      const bar = ticks(0, 120 / scale, 2)[1];
      pen.strokeStyle = INK; pen.lineWidth = 2;
      stroke(pen, [[10, h - 8], [10 + bar * scale, h - 8]]);
      pen.fillStyle = INK; pen.textAlign = "left"; pen.textBaseline = "bottom";
      pen.fillText(`${bar} m`, 10, h - 11);
      pen.textAlign = "center"; pen.textBaseline = "top";
      for (const stretch of a.stretches) {
        const [x, y] = stretch.points[Math.floor(stretch.points.length / 2)];
        pen.fillText(stretch.name, Math.min(Math.max(X(x), 30), w - 30), Math.min(Y(y) + 10, h - 14));
      }
    }

    vehicle(pen, x, y, yaw, length) {
      pen.save();
      pen.translate(x, y);
      pen.rotate(-yaw);
      const l = length / 2, b = length / 4;
      pen.fillStyle = INK;
      for (const u of [-0.62, 0.62]) for (const v of [-1, 1]) pen.fillRect(l * u - l / 4, 1.05 * b * v - b / 5, l / 2, b / 2.5);
      pen.fillStyle = "#E69F00"; pen.strokeStyle = INK; pen.lineWidth = 1.2;
      pen.beginPath();
      pen.moveTo(-l, -b); pen.lineTo(0.7 * l, -b); pen.lineTo(l, 0); pen.lineTo(0.7 * l, b); pen.lineTo(-l, b);
      pen.closePath();
      pen.fill(); pen.stroke();
      pen.restore();
    }

    // ---------------------------------------------------------------- wheels

    drawWheels() {
      const [pen, w, h] = ready(this.wheels), wheels = this.data.wheels, part = w / wheels.length;
      const surface = 0.68 * h, radius = Math.min(0.27 * part, 0.3 * h);
      const i = this.index;
      const depth = wheel => wheel.sinkage && known(wheel.sinkage[i]) ?
        Math.max(wheel.sinkage[i], 0) * radius / wheel.radius : 0;
      pen.fillStyle = SOIL;
      pen.fillRect(0, surface, w, h - surface);
      // The vehicle drives to the right, so that its front wheel, the first one, stands there.
      wheels.forEach((wheel, place) => {
        const k = wheels.length - 1 - place;
        const x = part * (k + 0.5), z = depth(wheel), y = surface - radius + z;
        const rut = (from, to, deep) => {
          pen.clearRect(from, surface - 1, to - from, deep + 1);
          pen.fillStyle = DEEP;
          pen.fillRect(from, surface + deep, to - from, 3);
        };
        rut(k * part, x, z);
        if (place > 0) rut(x, (k + 1) * part, depth(wheels[place - 1]));  // of the wheel in front of it
        pen.beginPath(); pen.arc(x, y, radius, 0, 2 * Math.PI);
        pen.fillStyle = "#fff"; pen.fill();
        pen.strokeStyle = INK; pen.lineWidth = 4; pen.stroke();
        pen.lineWidth = 1.5;
        for (let spoke = 0; spoke < 6; spoke++) {
          const angle = wheel.turned[i] + spoke * Math.PI / 3;
          stroke(pen, [[x, y], [x + 0.9 * radius * Math.cos(angle), y + 0.9 * radius * Math.sin(angle)]]);
        }
        const words = [wheel.name];
        if (wheel.sinkage) words.push(`sinkage ${known(wheel.sinkage[i]) ? (1000 * wheel.sinkage[i]).toFixed(0) : "–"} mm`);
        if (wheel.slip) words.push(`slip ${known(wheel.slip[i]) ? (100 * wheel.slip[i]).toFixed(0) : "–"} %`);
        pen.fillStyle = INK; pen.textAlign = "center"; pen.textBaseline = "bottom";
        words.forEach((word, row) => pen.fillText(word, x, h - 4 - 15 * (words.length - 1 - row)));
      });
      pen.strokeStyle = QUIET; pen.lineWidth = 1; pen.setLineDash([3, 3]);
      stroke(pen, [[0, surface], [w, surface]]);
      pen.setLineDash([]);
    }

    // ---------------------------------------------------------------- charts

    chart(content) {
      const figure = make("div", this.box, { class: "view" });
      const name = make("div", figure, { class: "name" });
      name.textContent = content.unit ? `${content.title} [${content.unit}]` : content.title;
      const values = content.lines.map((line, k) => {
        const entry = make("span", name, { class: "key" });
        make("i", entry, { style: `background:${COLOURS[k % COLOURS.length]}` });
        entry.append(`${line.label} `);
        return make("b", entry);
      });
      const canvas = make("canvas", figure, { class: "chart", role: "img", "aria-label": name.textContent });
      const chart = { content, canvas, values };
      let from = null;
      const time = event => {
        const frame = canvas.getBoundingClientRect(), share = (event.clientX - frame.left - LEFT) / (frame.width - LEFT - RIGHT);
        return this.zoom[0] + Math.min(Math.max(share, 0), 1) * (this.zoom[1] - this.zoom[0]);
      };
      canvas.onpointerdown = event => { from = time(event); canvas.setPointerCapture(event.pointerId); };
      canvas.onpointermove = event => {
        if (from === null) return;
        this.selection = [from, time(event)].sort((a, b) => a - b);
        this.draw();
      };
      canvas.onpointercancel = () => { from = null; this.selection = null; this.draw(); };
      canvas.onpointerup = event => {
        const limits = [from, time(event)].sort((a, b) => a - b);
        from = this.selection = null;
        if (limits[1] - limits[0] > 0.02 * (this.zoom[1] - this.zoom[0])) this.setZoom(limits);
        else {
          const near = this.data.t.reduce((best, t, i) => Math.abs(t - limits[0]) < Math.abs(this.data.t[best] - limits[0]) ? i : best, 0);
          this.go(near);
        }
      };
      canvas.ondblclick = () => this.setZoom(this.whole);
      return chart;
    }

    // Smallest and largest value within the stretch of time that is seen.
    limits(lines) {
      let low = Infinity, high = -Infinity;
      for (const line of lines) for (const values of [line.values, line.low, line.high]) {
        if (values) values.forEach((value, i) => {
          if (!known(value) || this.data.t[i] < this.zoom[0] || this.data.t[i] > this.zoom[1]) return;
          low = Math.min(low, value); high = Math.max(high, value);
        });
      }
      if (low > high) return [0, 1];
      const room = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
      return [low - room, high + room];
    }

    drawChart(chart) {
      const [pen, w, h] = ready(chart.canvas), t = this.data.t, [begin, end] = this.zoom;
      chart.canvas.dataset.from = begin;
      chart.canvas.dataset.to = end;
      const [low, high] = this.limits(chart.content.lines);
      const X = time => LEFT + (time - begin) / (end - begin) * (w - LEFT - RIGHT);
      const Y = value => h - BOTTOM - (value - low) / (high - low) * (h - TOP - BOTTOM);
      this.axes(pen, w, h, X, Y, low, high);
      pen.save();
      pen.beginPath(); pen.rect(LEFT, TOP, w - LEFT - RIGHT, h - TOP - BOTTOM); pen.clip();
      chart.content.lines.forEach((line, k) => {
        pen.strokeStyle = pen.fillStyle = COLOURS[k % COLOURS.length];
        if (line.low && line.high) this.band(pen, line, X, Y);
        pen.lineWidth = 1.6;
        pen.setLineDash(line.dashed ? [5, 4] : []);
        stroke(pen, line.values.map((value, i) => [X(t[i]), known(value) ? Y(value) : null]));
        pen.setLineDash([]);
        chart.values[k].textContent = show(line.values[this.index]);
      });
      if (this.selection) {
        pen.fillStyle = "rgba(11,92,143,.15)";
        pen.fillRect(X(this.selection[0]), TOP, X(this.selection[1]) - X(this.selection[0]), h - TOP - BOTTOM);
      }
      pen.strokeStyle = INK; pen.lineWidth = 1;
      stroke(pen, [[X(t[this.index]), TOP], [X(t[this.index]), h - BOTTOM]]);
      pen.restore();
    }

    band(pen, line, X, Y) {
      pen.globalAlpha = 0.2;
      let start = 0;
      const fill = stop => {
        if (stop - start > 1) {
          pen.beginPath();
          for (let i = start; i < stop; i++) pen.lineTo(X(this.data.t[i]), Y(line.low[i]));
          for (let i = stop - 1; i >= start; i--) pen.lineTo(X(this.data.t[i]), Y(line.high[i]));
          pen.fill();
        }
        start = stop + 1;
      };
      line.low.forEach((value, i) => { if (!known(value) || !known(line.high[i])) fill(i); });
      fill(line.low.length);
      pen.globalAlpha = 1;
    }

    axes(pen, w, h, X, Y, low, high) {
      pen.lineWidth = 1; pen.strokeStyle = GRID; pen.fillStyle = QUIET;
      pen.textAlign = "right"; pen.textBaseline = "middle";
      const [values, size] = ticks(low, high, 4), [times, step] = ticks(...this.zoom, Math.max(w / 80, 3));
      for (const value of values) {
        stroke(pen, [[LEFT, Y(value)], [w - RIGHT, Y(value)]]);
        pen.fillText(label(value, size), LEFT - 5, Y(value));
      }
      pen.textAlign = "center"; pen.textBaseline = "top";
      for (const time of times) {
        stroke(pen, [[X(time), TOP], [X(time), h - BOTTOM]]);
        if (X(time) < w - 66) pen.fillText(label(time, step), X(time), h - BOTTOM + 5);
      }
      pen.textAlign = "right";
      pen.fillText("time [s]", w - RIGHT, h - BOTTOM + 5);
    }
  }

  for (const box of document.querySelectorAll(".playback")) box.player = new Playback(box);
})();
