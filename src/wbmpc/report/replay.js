// The replay of a run. Bodies are drawn from their shapes, lines as ribbons; nothing is loaded, and texts stay texts.
(() => {
  const box = document.querySelector(".replay"), find = name => box.querySelector(name);
  const canvas = find("canvas"), gl = canvas.getContext("webgl2");
  if (!gl) { find(".hint").textContent = "The replay needs WebGL 2, which this browser does not have."; canvas.remove(); find(".bar").remove(); return; }
  const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;

  // ---- quaternions (w, x, y, z), vectors
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const turn = (q, v) => { const u = q.slice(1), c = cross(u, v).map((x, i) => x + q[0] * v[i]), d = cross(u, c); return v.map((x, i) => x + 2 * d[i]) };
  const times = (a, b) => [a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
    a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]];
  const unit = v => { const n = Math.hypot(...v) || 1; return v.map(x => x / n) };

  // ---- triangles of shapes: position and normal of each corner
  const lathe = (profile, sides = 28) => {
    const out = [], corner = ([r, z, nr, nz], a) => out.push(r * Math.cos(a), r * Math.sin(a), z, nr * Math.cos(a), nr * Math.sin(a), nz);
    for (let i = 1; i < profile.length; i++) for (let k = 0; k < sides; k++) {
      const a = 2 * Math.PI * k / sides, b = 2 * Math.PI * (k + 1) / sides, [p, q] = [profile[i - 1], profile[i]];
      corner(p, a); corner(q, a); corner(q, b); corner(p, a); corner(q, b); corner(p, b);
    }
    return out;
  };
  const round = (r, h) => Array.from({ length: 18 }, (_, i) => {
    const a = Math.PI * ((i < 9 ? i : i - 1) / 16 - 0.5), c = Math.cos(a), s = Math.sin(a);
    return [r * c, r * s + (i < 9 ? -h : h), c, s];
  });
  const flat = (corners, faces) => {
    const out = [], at = i => [corners[3 * i], corners[3 * i + 1], corners[3 * i + 2]];
    for (let f = 0; f + 2 < faces.length; f += 3) {
      const [a, b, c] = [at(faces[f]), at(faces[f + 1]), at(faces[f + 2])];
      const n = unit(cross(b.map((x, i) => x - a[i]), c.map((x, i) => x - a[i])));
      for (const p of [a, b, c]) out.push(...p, ...n);
    }
    return out;
  };
  const cube = (s, o = [0, 0, 0]) => flat([...Array(8).keys()].flatMap(k => [0, 1, 2].map(i => o[i] + (k >> i & 1 ? s[i] : -s[i]))),
    [0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5]);
  const triangles = s => {
    const [a, b, c] = s.size;
    if (s.kind === "box") return cube(s.size, s.offset);
    if (s.kind === "sphere") return lathe(round(a, 0));
    if (s.kind === "capsule") return lathe(round(a, b));
    if (s.kind === "cylinder") return lathe([[0, -b, 0, -1], [a, -b, 0, -1], [a, -b, 1, 0], [a, b, 1, 0], [a, b, 0, 1], [0, b, 0, 1]]);
    if (s.kind === "ellipsoid") return lathe(round(1, 0)).map((x, i) => i % 6 < 3 ? x * [a, b, c][i % 6] : x / [a, b, c][i % 6 - 3]);
    return flat(new Float32Array(bytes(s.vertices)), new Uint32Array(bytes(s.faces)));
  };

  // ---- programs
  const program = (vertex, fragment) => {
    const made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, `#version 300 es\nprecision highp float;${text}`); gl.compileShader(shader); gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    return new Proxy(made, { get: (p, name) => name === "it" ? p : gl.getUniformLocation(p, name) });
  };
  const makeSolid = () => program(`layout(location=0) in vec3 p; layout(location=1) in vec3 n; uniform mat4 view; uniform vec4 q; uniform vec3 o; out vec3 normal;
    vec3 turn(vec3 v) { return v + 2.0 * cross(q.yzw, cross(q.yzw, v) + q.x * v); }
    void main() { normal = turn(n); gl_Position = view * vec4(turn(p) + o, 1.0); }`,
  `in vec3 normal; uniform vec4 color; out vec4 ink; void main() { vec3 n = normalize(normal) * (gl_FrontFacing ? 1.0 : -1.0);
    float light = 0.78 + 0.14 * n.z + 0.36 * max(dot(n, normalize(vec3(0.4, -0.6, 1.0))), 0.0); ink = vec4(color.rgb * light * color.a, color.a); }`);
  const makeRibbon = () => program(`layout(location=0) in vec3 a; layout(location=1) in vec3 b; layout(location=2) in vec2 s; uniform mat4 view; uniform vec2 size;
    uniform float width; void main() { vec4 A = view * vec4(a, 1.0), B = view * vec4(b, 1.0); vec2 d = (B.xy / B.w - A.xy / A.w) * size;
    d = length(d) > 1e-6 ? normalize(d) : vec2(1.0, 0.0); vec4 c = mix(A, B, s.x); c.xy += vec2(-d.y, d.x) * s.y * width / size * c.w;
    gl_Position = A.w > 0.0 && B.w > 0.0 ? c : vec4(2.0, 2.0, 2.0, 1.0); }`,
  "uniform vec4 color; out vec4 ink; void main() { ink = vec4(color.rgb * color.a, color.a); }");

  let solid = makeSolid(), ribbon = makeRibbon();

  const buffer = (numbers, sizes) => {
    const array = gl.createVertexArray(), stride = 4 * sizes.reduce((x, y) => x + y), held = gl.createBuffer();
    gl.bindVertexArray(array); gl.bindBuffer(gl.ARRAY_BUFFER, held); gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(numbers), gl.STATIC_DRAW);
    sizes.reduce((at, n, i) => { gl.enableVertexAttribArray(i); gl.vertexAttribPointer(i, n, gl.FLOAT, false, stride, at); return at + 4 * n }, 0);
    return { array, held, count: 4 * numbers.length / stride };
  };
  const forget = held => { gl.deleteVertexArray(held.array); gl.deleteBuffer(held.held) };
  // segments between points; a missing point (null) leaves a gap. Each segment has six corners
  const segments = pairs => pairs.flatMap(([a, b]) => [[0, -1], [1, -1], [1, 1], [0, -1], [1, 1], [0, 1]].flatMap(s => [...a, ...b, ...s]));
  const path = points => segments(points.slice(1).map((b, i) => points[i] && b ? [points[i], b] : [[0, 0, -1e3], [0, 0, -1e3]]));
  const lines = numbers => buffer(numbers, [3, 3, 2]);

  // ---- a part of the run
  const prepared = part => {
    if (part.at) return part;
    part.at = new Float64Array(bytes(part.times)); part.flat = new Int16Array(bytes(part.poses)); part.dots = new Int16Array(bytes(part.points));
    part.drawn = part.shapes.map(s => ({ ...s, ...buffer(triangles(s), [3, 3]) })).sort((a, b) => b.color[3] - a.color[3]);
    const place = (k, i) => { const at = 3 * (k * part.count + i);
      return part.dots[at] === part.none ? null : [0, 1, 2].map(j => part.middle[j] + part.half * part.dots[at + j] / part.full) };
    part.place = place;
    const all = i => path([...part.at.keys()].map(k => place(k, i)));
    part.trail = lines(all(0)); part.goal = lines(all(1));
    const near = part.bodies.map(b => Math.hypot(...[0, 1, 2].map(i => b[i] - part.bodies[part.robot][i]))).filter(d => d < 2.5);
    part.distance = 0.9 + 2.3 * Math.max(...near);
    part.height = 0.45 * Math.max(0.5, ...part.bodies.filter((b, i) => Math.hypot(b[0] - part.bodies[part.robot][0], b[1] - part.bodies[part.robot][1]) < 2.5).map(b => b[2]));
    const reach = Math.ceil(part.half) + 4, [x, y] = part.middle.map(Math.round), grid = [];
    const step = Math.max(1, Math.ceil(reach / 30));
    for (let i = -reach; i <= reach; i += step) for (let j = -reach; j < reach; j += step)
      grid.push([[x + i, y + j, 0], [x + i, y + j + step, 0]], [[x + j, y + i, 0], [x + j + step, y + i, 0]]);
    part.grid = lines(segments(grid));
    return part;
  };
  const parts = JSON.parse(find(".data").textContent);
  let part = prepared(parts[0]), now = 0, playing = false, last = 0, look = { azimuth: -0.7, elevation: 0.42, zoom: 1 }, anchor = null, asked = false;

  const poses = t => {
    let k = 0, top = part.at.length - 1;
    while (top - k > 1) { const m = (k + top) >> 1; if (part.at[m] <= t) k = m; else top = m }
    const share = Math.min(Math.max((t - part.at[k]) / (part.at[top] - part.at[k] || 1), 0), 1), out = part.bodies.map(b => [b.slice(0, 3), b.slice(3)]);
    part.moving.forEach((body, i) => {
      const [a, b] = [k, top].map(f => part.flat.subarray(7 * (f * part.moving.length + i), 7 * (f * part.moving.length + i) + 7));
      const sign = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6] < 0 ? -1 : 1, mix = (i, s = 1) => a[i] + share * (s * b[i] - a[i]);
      out[body] = [[0, 1, 2].map(i => part.middle[i] + part.half * mix(i) / part.full), unit([3, 4, 5, 6].map(i => mix(i, sign)))];
    });
    return [out, k];
  };
  const camera = target => {
    const { azimuth: a, elevation: e, zoom } = look, back = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    const right = [-Math.sin(a), Math.cos(a), 0], up = cross(back, right), d = part.distance * zoom;
    const eye = target.map((x, i) => x + d * back[i]), f = 1 / Math.tan(0.35), near = 0.05, far = 300;
    const aspect = canvas.width / canvas.height, g = f * Math.min(1, aspect / 1.2), dot = v => -(v[0] * eye[0] + v[1] * eye[1] + v[2] * eye[2]);
    const rows = [[...right, dot(right)].map(x => x * g / aspect), [...up, dot(up)].map(x => x * g),
      [...back, dot(back)].map(x => -x * (far + near) / (far - near)), [...back, dot(back)].map(x => -x)];
    rows[2][3] -= 2 * far * near / (far - near);
    return [0, 1, 2, 3].flatMap(c => rows.map(r => r[c]));
  };
  const draw = () => {
    asked = false;
    const ratio = Math.min(devicePixelRatio || 1, 2), w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h }
    const [placed, k] = poses(now), robot = placed[part.robot][0];
    if (find(".follow").checked || !anchor) anchor = [robot[0], robot[1], part.height];
    const view = camera(anchor);
    gl.viewport(0, 0, w, h); gl.clearColor(0, 0, 0, 0); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST); gl.enable(gl.BLEND); gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.useProgram(ribbon.it); gl.uniformMatrix4fv(ribbon.view, false, view); gl.uniform2f(ribbon.size, w, h);
    const line = (what, color, width, count = what.count) => { gl.uniform4fv(ribbon.color, color); gl.uniform1f(ribbon.width, width * ratio);
      gl.bindVertexArray(what.array); gl.drawArrays(gl.TRIANGLES, 0, count) };
    line(part.grid, [0.5, 0.55, 0.6, 0.35], 1);
    line(part.goal, [0.9, 0.27, 0.12, 1], 2.2); line(part.trail, [0.24, 0.3, 0.4, 1], 2.6, 6 * k);
    for (const [i, color] of [[0, [0.12, 0.43, 0.86, 1]], [1, [0.16, 0.63, 0.35, 1]]]) {
      const count = (part.count - 2) / 2, ahead = lines(path(Array.from({ length: count }, (_, j) => part.place(k, 2 + i * count + j))));
      line(ahead, color, 3); forget(ahead);
    }
    gl.useProgram(solid.it); gl.uniformMatrix4fv(solid.view, false, view);
    for (const s of part.drawn) {
      const [o, q] = s.body < 0 ? [[0, 0, 0], [1, 0, 0, 0]] : placed[s.body], at = turn(q, s.pose.slice(0, 3));
      gl.uniform4fv(solid.q, times(q, s.pose.slice(3))); gl.uniform3fv(solid.o, at.map((x, i) => x + o[i])); gl.uniform4fv(solid.color, s.color);
      gl.depthMask(s.color[3] > 0.99); gl.bindVertexArray(s.array); gl.drawArrays(gl.TRIANGLES, 0, s.count);
    }
    gl.depthMask(true);
  };
  const redraw = () => { if (!asked) { asked = true; requestAnimationFrame(draw) } };
  const slider = find("input[type=range]"), button = find(".play");
  const show = t => {
    now = Math.min(Math.max(t, part.at[0]), part.at[part.at.length - 1]); slider.value = now; redraw();
    find("output").textContent = `${now.toFixed(1)} s of ${part.at[part.at.length - 1].toFixed(1)} s`;
    document.dispatchEvent(new CustomEvent("replay-time", { detail: now }));
  };
  const play = on => { playing = on; button.textContent = on ? "Pause" : "Play"; last = performance.now(); if (on) requestAnimationFrame(step) };
  const step = at => {
    if (!playing) return;
    const end = part.at[part.at.length - 1];
    show(now + Number(find(".speed").value) * Math.min(at - last, 250) / 1000); last = at;
    if (now >= end) play(false); else requestAnimationFrame(step);
  };
  const choose = k => { part = prepared(parts[k]); anchor = null; slider.min = part.at[0]; slider.max = part.at[part.at.length - 1]; show(part.at[0]) };
  const zoom = factor => { look.zoom = Math.min(Math.max(look.zoom * factor, 0.2), 8); redraw() };
  button.addEventListener("click", () => { if (!playing && now >= part.at[part.at.length - 1]) show(part.at[0]); play(!playing) });
  slider.addEventListener("input", () => { play(false); show(Number(slider.value)) });
  find(".part").addEventListener("change", event => { play(false); choose(event.target.selectedIndex) });
  find(".follow").addEventListener("change", redraw);
  find(".in").addEventListener("click", () => zoom(0.8)); find(".out").addEventListener("click", () => zoom(1.25));
  canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", event => { if (!canvas.hasPointerCapture(event.pointerId)) return;
    look.azimuth -= 0.008 * event.movementX; look.elevation = Math.min(Math.max(look.elevation + 0.008 * event.movementY, -0.1), 1.5); redraw() });
  canvas.addEventListener("keydown", event => { if (event.key === " ") { event.preventDefault(); button.click() } });
  document.addEventListener("replay-seek", event => { play(false); show(event.detail) });
  new ResizeObserver(redraw).observe(canvas);
  // browsers take contexts away (too many pictures on a page, a driver that restarts): what they held is rebuilt
  canvas.addEventListener("webglcontextlost", event => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    solid = makeSolid(); ribbon = makeRibbon();
    for (const p of parts) delete p.at;
    prepared(part); redraw();
  });
  for (const { name } of parts) find(".part").add(new Option(name || "run"));
  find(".part").hidden = parts.length < 2;
  choose(0);
})();
