// Reads values off the plots that the page already holds, hides and shows operating points, sorts tables.
// Nothing is computed here but places on the screen and the ends of bands (value + reach). No network, no storage.
"use strict";
(function () {
  var root = document.documentElement, errors = 0;
  window.addEventListener("error", function () { errors += 1; root.dataset.errors = String(errors); });
  root.dataset.errors = "0";
  root.classList.add("js");

  var data = JSON.parse(document.getElementById("report-data").textContent);
  var SVG = "http://www.w3.org/2000/svg";

  function make(name, attributes, words) {
    var node = document.createElement(name);
    Object.keys(attributes || {}).forEach(function (key) { node.setAttribute(key, attributes[key]); });
    if (words !== undefined) node.textContent = words;
    return node;
  }

  function draw(svg, name, attributes) {
    var node = document.createElementNS(SVG, name);
    Object.keys(attributes).forEach(function (key) { node.setAttribute(key, attributes[key]); });
    svg.appendChild(node);
    return node;
  }

  function shown(value, decimals) {
    if (value === null || value === undefined) return "\u2013";
    return value.toFixed(decimals).replace("-", "\u2212");
  }

  // ---- plots ----

  // a scale as the page wrote it: low, high, and their places on the picture
  function scale(words, log) {
    var n = words.split(" ").map(Number), low = log ? Math.log(n[0]) : n[0], high = log ? Math.log(n[1]) : n[1];
    return function (value) { return n[2] + (n[3] - n[2]) * ((log ? Math.log(value) : value) - low) / (high - low); };
  }

  // magnitude of a response on one line with its 95 % band
  function magnitude(point, name, k) {
    var size = point.db[name][k], reach = data.reach_of[name];
    if (size === null) return "\u2013";
    var low = point.down[reach][k] <= -300 ? "\u2212\u221e" : shown(size + point.down[reach][k], 2);
    return shown(size, 2) + " dB (" + low + " \u2026 " + shown(size + point.up[reach][k], 2) + ")";
  }

  function phase(point, name, k) {
    return shown(point.deg[name][k], 1) + " deg (\u00b1" + shown(point.reach[k], 1) + ")";
  }

  // what a plot shows of one operating point: values along both axes, its words on one line, the ends of its band
  function viewOf(key, point) {
    if (key === "nichols") {
      return { x: point.deg.L, y: point.db.L, low: null, words: function (k) { return [magnitude(point, "L", k), phase(point, "L", k)]; } };
    }
    var name = key.split("-")[0];
    if (key.split("-")[1] === "deg") {
      return {
        x: point.f, y: point.deg[name], words: function (k) { return [phase(point, name, k)]; },
        low: function (k) { return point.deg[name][k] - point.reach[k]; },
        high: function (k) { return point.deg[name][k] + point.reach[k]; }
      };
    }
    var reach = data.reach_of[name];
    return {
      x: point.f, y: point.db[name], words: function (k) { return [magnitude(point, name, k)]; },
      low: function (k) { return point.db[name][k] + point.down[reach][k]; },
      high: function (k) { return point.db[name][k] + point.up[reach][k]; }
    };
  }

  function enhance(box, points) {
    var visible = points.map(function () { return true; });
    var grid = box.querySelector(".plot-grid");
    var panels = Array.prototype.map.call(grid.querySelectorAll("svg[data-plot]"), panelOf);
    var readout = make("output", { "class": "readout", "aria-live": "polite" });
    readout.hidden = true;
    box.appendChild(readout);
    var at = null; // operating point and line that are marked

    function panelOf(svg) {
      var x = scale(svg.dataset.x, svg.dataset.log === "1"), y = scale(svg.dataset.y, false);
      var range = svg.dataset.x.split(" ").map(Number), across = svg.dataset.y.split(" ").map(Number);
      var views = points.map(function (point) { return viewOf(svg.dataset.plot, point); });
      return {
        svg: svg, figure: svg.parentNode, views: views, log: svg.dataset.log === "1", range: range, across: across, y: y,
        places: views.map(function (view) {
          return view.x.map(function (value, k) {
            return value === null || view.y[k] === null ? null : [x(value), y(view.y[k])];
          });
        })
      };
    }

    function inside(panel, place) {
      return place[0] >= panel.range[2] - 0.5 && place[0] <= panel.range[3] + 0.5 &&
        place[1] <= panel.across[2] + 0.5 && place[1] >= panel.across[3] - 0.5;
    }

    // nearest line of all visible operating points
    function nearest(panel, px, py) {
      var best = null, least = Infinity;
      panel.places.forEach(function (places, op) {
        if (!visible[op]) return;
        places.forEach(function (place, k) {
          if (place === null || !inside(panel, place)) return;
          var d = Math.hypot(place[0] - px, place[1] - py);
          if (d < least) { least = d; best = { op: op, k: k }; }
        });
      });
      return best;
    }

    // the band of one operating point, where the page holds none because there are many
    function bandOf(panel, op) {
      var view = panel.views[op], up = [], down = [];
      if (!view.low || panel.svg.querySelector(".band:not(.drawn)")) return;
      panel.places[op].forEach(function (place, k) {
        if (place === null) return;
        up.push(place[0].toFixed(1) + " " + Math.max(panel.y(view.high(k)), -999).toFixed(1));
        down.push(place[0].toFixed(1) + " " + Math.min(panel.y(view.low(k)), 1999).toFixed(1));
      });
      if (!up.length) return;
      var path = "M" + up.join("L") + "L" + down.reverse().join("L") + "Z";
      draw(panel.svg.querySelector("g[clip-path]"), "path", { "class": "band on drawn", d: path, fill: points[op].colour });
    }

    function highlight(op) {
      grid.querySelectorAll(".drawn").forEach(function (node) { node.remove(); });
      if (op !== null) panels.forEach(function (panel) { bandOf(panel, op); });
      grid.classList.toggle("has-focus", op !== null && points.length > 1);
      grid.querySelectorAll("[data-op]").forEach(function (node) {
        node.classList.toggle("on", op !== null && Number(node.dataset.op) === op);
      });
    }

    function clear() {
      at = null;
      readout.hidden = true;
      highlight(null);
      box.querySelectorAll(".mark, .hair, .tip").forEach(function (node) { node.remove(); });
    }

    // mark one line of one operating point in every plot of the loop; `here` is the plot that gets the note
    function show(found, here) {
      clear();
      if (found === null) return;
      at = found;
      var point = points[found.op], k = found.k;
      highlight(found.op);
      panels.forEach(function (panel) {
        var place = panel.places[found.op][k];
        if (place === null || !inside(panel, place)) return;
        if (panel.log) {
          draw(panel.svg, "path", { "class": "hair", d: "M" + place[0] + " " + panel.across[2] + "V" + panel.across[3] });
        }
        draw(panel.svg, "circle", { "class": "mark", cx: place[0], cy: place[1], r: 4.5 });
        if (panel === here) note(panel, place, point, found.op, k);
      });
      readout.hidden = false;
      readout.replaceChildren(make("span", {}, ""));
      readout.firstChild.append(make("b", {}, point.name), " " + point.label + " at ", make("b", {}, point.f[k] + " Hz"));
      Object.keys(point.db).forEach(function (name) {
        var item = make("span");
        item.append(make("b", {}, "|" + name + "| "), magnitude(point, name, k));
        if (point.deg[name]) item.append(", " + phase(point, name, k));
        readout.append(item);
      });
      readout.append(make("small", {}, "in brackets the 95 % reach of this line"));
    }

    function note(panel, place, point, op, k) {
      var tip = make("div", { "class": "tip", "aria-hidden": "true" });
      [point.label ? point.name + ": " + point.label : point.name, point.f[k] + " Hz"].concat(panel.views[op].words(k))
        .forEach(function (words) { tip.append(make("div", {}, words)); });
      panel.figure.append(tip);
      var box = panel.svg.getBoundingClientRect(), frame = panel.figure.getBoundingClientRect();
      var view = panel.svg.viewBox.baseVal, ratio = box.width / view.width;
      var left = box.left - frame.left + place[0] * ratio + 12, top = box.top - frame.top + place[1] * ratio + 12;
      if (left + tip.offsetWidth > frame.width - 4) left = Math.max(4, left - tip.offsetWidth - 24);
      if (top + tip.offsetHeight > frame.height - 4) top = Math.max(4, top - tip.offsetHeight - 24);
      tip.style.left = left + "px";
      tip.style.top = top + "px";
    }

    function step(panel, along, across) {
      var ops = points.map(function (_, op) { return op; }).filter(function (op) { return visible[op]; });
      if (!ops.length) return;
      if (at === null) { show({ op: ops[0], k: Math.floor(points[ops[0]].f.length / 2) }, panel); return; }
      var op = at.op, k = at.k;
      if (across) {
        var f = points[op].f[k];
        op = ops[(Math.max(0, ops.indexOf(op)) + across + ops.length) % ops.length];
        k = points[op].f.reduce(function (best, value, j) {
          return Math.abs(value - f) < Math.abs(points[op].f[best] - f) ? j : best;
        }, 0);
      }
      show({ op: op, k: Math.min(Math.max(k + along, 0), points[op].f.length - 1) }, panel);
    }

    panels.forEach(function (panel) {
      var svg = panel.svg, keys = {
        ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1], Home: [-1e9, 0], End: [1e9, 0]
      };
      svg.setAttribute("tabindex", "0");
      svg.setAttribute("role", "application");
      svg.setAttribute("aria-roledescription", "plot; arrow keys move along it");
      function look(event) {
        var matrix = svg.getScreenCTM();
        if (!matrix) return;
        var spot = new DOMPoint(event.clientX, event.clientY).matrixTransform(matrix.inverse());
        show(nearest(panel, spot.x, spot.y), panel);
      }
      svg.addEventListener("pointermove", function (event) { if (event.pointerType !== "touch") look(event); });
      svg.addEventListener("click", look);
      svg.addEventListener("pointerleave", function (event) { if (event.pointerType !== "touch") clear(); });
      svg.addEventListener("keydown", function (event) {
        if (event.key === "Escape") { clear(); return; }
        var move = keys[event.key];
        if (!move) return;
        event.preventDefault();
        step(panel, move[0] * (event.shiftKey ? 10 : 1), move[1]);
      });
    });
    legend();

    function legend() {
      var list = box.querySelector(".legend"), entries = Array.prototype.slice.call(list.children);
      if (entries.length < 2) return;
      var boxes = entries.map(function (entry, op) {
        var label = make("label"), input = make("input", { type: "checkbox" });
        input.checked = true;
        label.append(input);
        while (entry.firstChild) label.append(entry.firstChild);
        entry.append(label);
        input.addEventListener("change", function () { set(op, input.checked); });
        entry.addEventListener("pointerenter", function () { if (visible[op]) highlight(op); });
        entry.addEventListener("pointerleave", function () { highlight(null); });
        return input;
      });
      function set(op, on) {
        visible[op] = boxes[op].checked = on;
        entries[op].classList.toggle("hidden-op", !on);
        grid.querySelectorAll('[data-op="' + op + '"]').forEach(function (node) { node.classList.toggle("off", !on); });
        if (at !== null && !visible[at.op]) clear();
      }
      var controls = make("div", { "class": "controls", role: "group", "aria-label": "Operating points shown" });
      function button(words, wanted) {
        var one = make("button", { type: "button" }, words);
        one.addEventListener("click", function () { boxes.forEach(function (_, op) { set(op, wanted(op)); }); });
        controls.append(one);
      }
      button("Show all", function () { return true; });
      button("Hide all", function () { return false; });
      if (list.querySelector(".flag")) button("Only the worst", function (op) { return !!entries[op].querySelector(".flag"); });
      list.before(controls);
    }
  }

  // ---- tables ----

  function value(cell) {
    var words = cell.dataset.value;
    return words === undefined ? NaN : words === "inf" ? Infinity : words === "-inf" ? -Infinity : Number(words);
  }

  function sorting(table) {
    var heads = Array.prototype.slice.call(table.tHead.rows[0].cells), body = table.tBodies[0];
    heads.forEach(function (head, column) {
      var button = make("button", { type: "button" });
      while (head.firstChild) button.append(head.firstChild);
      head.append(button);
      button.addEventListener("click", function () {
        var rising = head.getAttribute("aria-sort") !== "ascending";
        heads.forEach(function (other) { other.removeAttribute("aria-sort"); });
        head.setAttribute("aria-sort", rising ? "ascending" : "descending");
        Array.prototype.slice.call(body.rows).sort(function (a, b) {
          var first = a.cells[column], second = b.cells[column], x = value(first), y = value(second);
          if (isNaN(x) && isNaN(y)) {
            return (rising ? 1 : -1) * first.textContent.localeCompare(second.textContent, "en", { numeric: true });
          }
          if (isNaN(x) || isNaN(y)) return isNaN(x) ? 1 : -1; // what is not there stands last
          return x === y ? 0 : (rising ? 1 : -1) * (x < y ? -1 : 1);
        }).forEach(function (row) { body.append(row); });
      });
    });
  }

  // ---- page ----

  // a frame that scrolls must be reached by the keyboard
  function reachable() {
    document.querySelectorAll(".scroll").forEach(function (frame) {
      if (frame.scrollWidth > frame.clientWidth + 1) {
        frame.tabIndex = 0;
        frame.setAttribute("role", "region");
        frame.setAttribute("aria-label", "Table that scrolls sideways");
      }
    });
  }

  function measure() {
    root.dataset.width = String(root.clientWidth);
    root.dataset.overflow = String(root.scrollWidth - root.clientWidth);
    reachable();
  }

  document.querySelectorAll(".plots").forEach(function (box, k) { enhance(box, data.loops[k]); });
  document.querySelectorAll("table.sortable").forEach(sorting);
  window.addEventListener("beforeprint", function () {
    document.querySelectorAll("details:not(.screen)").forEach(function (part) { part.open = true; });
  });
  window.addEventListener("resize", measure);
  measure();
  root.dataset.report = "ready";
})();
