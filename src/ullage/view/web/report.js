// The replay of a run: world, flight, map and image in three dimensions, and the radars' profiles over time.
"use strict";
(async () => {
  const $ = (id) => document.getElementById(id);
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const KINDS = { f4: Float32Array, u4: Uint32Array, u1: Uint8Array };
  const STATE_COLORS = { "missed": "#e53935", "partly mapped": "#f2a93b" };
  const CELL_COLORS = { 1: [64, 190, 120, 75], 3: [242, 193, 78, 90] }; // free, ambiguous
  const LEGEND = [["occupied", "#f7b500"], ["free", "#40be78"], ["ambiguous", "#f2c14e"], ["surface not on the map", "#e53935"],
    ["object mapped in part", "#f2a93b"], ["flown path", "#ff2e63"]];
  const readable = (name) => name.replaceAll("_", " ");
  const MOST_EDGES = 60000; // triangles of an object whose edges are drawn
  // shares of the world's diagonal: drone, columns on occupied cells, beams, echoes, path, wires, wires that are missed
  const SHARES = { drone: 0.04, column: 0.02, beam: 0.1, echo: 0.0035, path: 0.0012, wire: 0.0009, missed: 0.0024 };

  async function readData() {
    const bytes = Uint8Array.from(atob($("data").textContent), (c) => c.charCodeAt(0));
    const text = await new Response(
      new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
    return JSON.parse(text, (key, value) => {
      if (!value || typeof value !== "object" || !("data" in value && "type" in value)) return value;
      const raw = Uint8Array.from(atob(value.data), (c) => c.charCodeAt(0));
      return new KINDS[value.type](raw.buffer);
    });
  }

  const data = await readData();
  $("replay").hidden = false;
  const flight = data.flight, radars = data.radars, frames = radars[0].t.length, end = radars[0].t[frames - 1];

  const [low, high] = data.bounds;
  const size = Math.max(Math.hypot(...low.map((v, k) => high[k] - v)), 1);

  // ---- the scene
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas: $("view"), antialias: true, alpha: true, preserveDrawingBuffer: true });
  } catch (error) {
    showWithoutWebGL(); // the profiles are still there
  }
  function showWithoutWebGL() { // the figure of the map in place of the scene, and the reason
    const map = document.querySelector(".figures img"), note = document.createElement("p");
    note.className = "note";
    note.textContent = "This browser offers no WebGL, so the world is not drawn in 3D. Profiles and figures do not need it.";
    $("stage").replaceChildren(note, ...(map ? [map.cloneNode()] : []));
  }
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(40, 1, 0.05, 2000);
  camera.up.set(0, 0, 1);
  const layers = {};
  const layer = (name) => {
    if (!layers[name]) scene.add((layers[name] = new THREE.Group()));
    return layers[name];
  };
  scene.add(new THREE.HemisphereLight(0xffffff, 0xaab4c0, 2.1));
  for (const [strength, ...place] of [[1.7, 0.2, -0.6, 1], [0.7, -1, 0.3, 0.3]]) {
    const lamp = new THREE.DirectionalLight(0xffffff, strength);
    lamp.position.set(...place);
    scene.add(lamp);
  }

  function cylinder(a, b, radius, material) {
    const from = new THREE.Vector3(...a), to = new THREE.Vector3(...b), along = to.clone().sub(from);
    const mesh = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, along.length(), 8), material);
    mesh.position.copy(from).addScaledVector(along, 0.5);
    mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.normalize());
    return mesh;
  }

  const labels = []; // of the scale and of north: an element of the page, and its place in the scene
  function label(text, place) {
    const element = document.createElement("span");
    element.className = "mark";
    element.textContent = text;
    $("stage").append(element);
    labels.push({ element, place: new THREE.Vector3(...place) });
  }
  function drawScale() { // a bar of round length along the lower edge, the height at the corner, and north (+y)
    const metres = [1, 2, 5, 10, 20, 50, 100, 200, 500].findLast((m) => m <= 0.35 * (high[0] - low[0])) || 1;
    const corner = [low[0], low[1] - 0.05 * size, low[2]], end = [low[0] + metres, corner[1], low[2]];
    const top = [low[0], corner[1], high[2]], tail = [high[0] + 0.04 * size, low[1] - 0.12 * size, low[2]];
    const tip = [tail[0], tail[1] + 0.1 * size, low[2]];
    const grey = new THREE.MeshBasicMaterial({ color: "#8d99ae" }), thin = SHARES.path * size;
    layer("scale").add(cylinder(corner, end, thin, grey), cylinder(corner, top, thin, grey),
      cylinder(tail, tip, thin, grey));
    const point = new THREE.Mesh(new THREE.CylinderGeometry(0, 4 * thin, 12 * thin, 12), grey); // points along +y
    point.position.set(...tip);
    layer("scale").add(point);
    label(`${metres} m`, end);
    label(`${low[2].toFixed(1)} m`, corner);
    label(`${high[2].toFixed(1)} m`, top);
    label("N (+y)", tail);
  }
  function drawLegend() {
    for (const [text, color] of LEGEND) {
      const item = document.createElement("span"), patch = document.createElement("i");
      patch.style.background = color;
      item.append(patch, text);
      $("legend").append(item);
    }
  }
  function drawUnmapped(points, step) { // surface in sight that is not on the map
    const shape = new THREE.InstancedMesh(new THREE.BoxGeometry(step, step, step),
      new THREE.MeshBasicMaterial({ color: "#e53935" }), points.length / 3);
    const place = new THREE.Matrix4();
    for (let k = 0; k < points.length / 3; k++) shape.setMatrixAt(k, place.makeTranslation(...points.subarray(3 * k, 3 * k + 3)));
    shape.frustumCulled = false;
    layer("not mapped").add(shape);
  }

  const meshes = {}, solids = []; // of each object, by its name; all that can be clicked
  const edge = new THREE.LineBasicMaterial({ color: "#1b2631", transparent: true, opacity: 0.25 });
  function drawWorld(world) {
    for (const thing of world.objects) {
      const color = STATE_COLORS[thing.state] || thing.color;
      const material = new THREE.MeshLambertMaterial({
        color, side: thing.hull ? THREE.FrontSide : THREE.DoubleSide, transparent: thing.alpha < 1, opacity: thing.alpha,
        depthWrite: thing.alpha === 1, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
      });
      const group = new THREE.Group();
      if (thing.corners.length) {
        const shape = new THREE.BufferGeometry();
        shape.setAttribute("position", new THREE.BufferAttribute(thing.corners, 3));
        shape.computeVertexNormals();
        const mesh = new THREE.Mesh(shape, material);
        mesh.userData = { name: thing.name, state: thing.state };
        group.add(mesh);
        solids.push(mesh);
        if (thing.corners.length < 9 * MOST_EDGES && !thing.hull) {
          group.add(new THREE.LineSegments(new THREE.EdgesGeometry(shape, 25), edge));
        }
      }
      for (let k = 0; k < thing.wires.length; k += 6) {
        const least = size * (thing.state === "missed" ? SHARES.missed : SHARES.wire); // thinner is not seen
        const radius = Math.max(thing.wire_radius[k / 6], least);
        group.add(cylinder(thing.wires.slice(k, k + 3), thing.wires.slice(k + 3, k + 6), radius, material));
      }
      meshes[thing.name] = { group, material, color };
      layer("world").add(group);
    }
  }

  function line(points, color, width) {
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.BufferAttribute(points, 3));
    return new THREE.Line(shape, new THREE.LineBasicMaterial({ color, transparent: width < 1, opacity: width }));
  }

  const drone = new THREE.Group();
  function drawDrone() {
    const body = new THREE.MeshLambertMaterial({ color: "#ff2e63", emissive: "#7a0f2d" });
    for (const turn of [Math.PI / 4, -Math.PI / 4]) {
      const arm = new THREE.Mesh(new THREE.BoxGeometry(0.9, 0.07, 0.05), body);
      arm.rotation.z = turn;
      drone.add(arm);
    }
    for (const [x, y] of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) {
      const rotor = new THREE.Mesh(new THREE.TorusGeometry(0.2, 0.03, 8, 24), body);
      rotor.position.set(0.32 * x, 0.32 * y, 0.05);
      drone.add(rotor);
    }
    drone.scale.setScalar(SHARES.drone * size / 0.9);
    layer("flight").add(drone);
  }

  function beamShape(radar) { // the -3 dB frustum in the sensor's frame
    const wide = Math.tan((radar.azimuth_deg * Math.PI) / 360), tall = Math.tan((radar.elevation_deg * Math.PI) / 360);
    const reach = Math.min(SHARES.beam * size, radar.range_m[1]), rim = [];
    for (const [y, z] of [[wide, tall], [-wide, tall], [-wide, -tall], [wide, -tall]]) {
      rim.push(new THREE.Vector3(1, y, z).setLength(reach));
    }
    const corners = [];
    rim.forEach((point, k) => corners.push(0, 0, 0, ...point, ...rim[(k + 1) % 4]));
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners), 3));
    const group = new THREE.Group();
    group.add(new THREE.Mesh(shape, new THREE.MeshBasicMaterial(
      { color: radar.color, transparent: true, opacity: 0.18, side: THREE.DoubleSide, depthWrite: false })));
    const edges = [];
    rim.forEach((point, k) => edges.push(0, 0, 0, ...point, ...point, ...rim[(k + 1) % 4]));
    const frame = new THREE.BufferGeometry();
    frame.setAttribute("position", new THREE.BufferAttribute(new Float32Array(edges), 3));
    group.add(new THREE.LineSegments(frame, new THREE.LineBasicMaterial({ color: radar.color })));
    return group;
  }

  function arcShape(radar) { // where the nearest echo may lie, at a range of 1 m
    const points = [];
    for (let k = 0; k <= 24; k++) {
      const turn = ((k / 24 - 0.5) * radar.azimuth_deg * Math.PI) / 180;
      points.push(Math.cos(turn), Math.sin(turn), 0);
    }
    return line(new Float32Array(points), radar.color, 1);
  }

  let beams = [], arcs = [], flown;
  function drawFlight() {
    layer("flight").add(line(flight.position, "#8d99ae", 0.6));
    flown = new THREE.InstancedMesh(new THREE.CylinderGeometry(SHARES.path * size, SHARES.path * size, 1, 6),
      new THREE.MeshBasicMaterial({ color: "#ff2e63" }), Math.max(frames - 1, 1));
    flown.frustumCulled = false;
    const from = new THREE.Vector3(), to = new THREE.Vector3(), stretch = new THREE.Object3D();
    for (let k = 0; k + 1 < flight.t.length; k++) {
      from.fromArray(flight.position, 3 * k);
      to.fromArray(flight.position, 3 * k + 3);
      stretch.position.copy(from).add(to).multiplyScalar(0.5);
      stretch.scale.set(1, Math.max(from.distanceTo(to), 1e-6), 1);
      stretch.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), to.sub(from).normalize());
      stretch.updateMatrix();
      flown.setMatrixAt(k, stretch.matrix);
    }
    layer("flight").add(flown);
    drawDrone();
    beams = radars.map((radar) => layer("beams").add(beamShape(radar)).children.at(-1));
    arcs = radars.map((radar) => layer("echoes").add(arcShape(radar)).children.at(-1));
  }

  // ---- planes of cells: the map and the image
  function plane(grid, paint) {
    const [ny, nx] = grid.shape.slice(-2), sheet = document.createElement("canvas");
    sheet.width = nx;
    sheet.height = ny;
    const texture = new THREE.CanvasTexture(sheet);
    texture.magFilter = THREE.NearestFilter;
    texture.colorSpace = THREE.SRGBColorSpace;
    const mesh = new THREE.Mesh(
      new THREE.PlaneGeometry(nx * grid.step, ny * grid.step),
      new THREE.MeshBasicMaterial({ map: texture, transparent: true, side: THREE.DoubleSide, depthWrite: false }));
    mesh.position.set(grid.origin[0] + (nx * grid.step) / 2, grid.origin[1] + (ny * grid.step) / 2, grid.origin[2]);
    return { mesh, texture, nx, ny, pen: sheet.getContext("2d"), pixels: new ImageData(nx, ny) };
  }
  function show(sheet) {
    sheet.pen.putImageData(sheet.pixels, 0, 0);
    sheet.texture.needsUpdate = true;
  }
  function setPixel(sheet, cell, [r, g, b, a]) {
    const x = cell % sheet.nx, y = Math.floor(cell / sheet.nx) % sheet.ny;
    sheet.pixels.data.set([r, g, b, a], 4 * ((sheet.ny - 1 - y) * sheet.nx + x)); // the first row is the highest y
  }

  let floor, walls, cells, shownMaps = 0;
  const still = new THREE.Matrix4();
  function drawMap(map) {
    cells = new Uint8Array(map.shape.reduce((a, b) => a * b));
    const most = new Set(map.cell.filter((_, k) => map.state[k] === 2)).size;
    const material = new THREE.MeshLambertMaterial({ color: "#f7b500", emissive: "#5a3d00" });
    const height = map.dims === 2 ? Math.max(SHARES.column * size, map.step) : map.step;
    walls = new THREE.InstancedMesh(new THREE.BoxGeometry(map.step, map.step, height), material, Math.max(most, 1));
    walls.frustumCulled = false;
    layer("map").add(walls);
    if (map.dims === 2) {
      floor = plane(map);
      layer("map").add(floor.mesh);
    }
    showMap(map, 0);
  }
  function showMap(map, t) {
    let count = 0;
    while (count < map.t.length && map.t[count] <= t + 1e-3) count++;
    if (count === shownMaps && walls.count) return;
    const from = count > shownMaps ? (shownMaps ? map.end[shownMaps - 1] : 0) : 0;
    if (!from) {
      cells.fill(0);
      if (floor) floor.pixels.data.fill(0);
    }
    for (let k = from; k < (count ? map.end[count - 1] : 0); k++) {
      cells[map.cell[k]] = map.state[k];
      if (floor) setPixel(floor, map.cell[k], CELL_COLORS[map.state[k]] || [0, 0, 0, 0]);
    }
    if (floor) show(floor);
    shownMaps = count;
    const [ny, nx] = map.shape.slice(-2), step = map.step;
    let n = 0;
    for (let cell = 0; cell < cells.length; cell++) {
      if (cells[cell] !== 2) continue;
      const z = map.dims === 3 ? (Math.floor(cell / (nx * ny)) + 0.5) * step : 0;
      still.makeTranslation(map.origin[0] + ((cell % nx) + 0.5) * step,
        map.origin[1] + ((Math.floor(cell / nx) % ny) + 0.5) * step, map.origin[2] + z);
      walls.setMatrixAt(n++, still);
    }
    walls.count = n;
    walls.instanceMatrix.needsUpdate = true;
  }
  function drawImage(image) {
    const sheet = plane(image);
    sheet.mesh.position.z += 0.02;
    image.level.forEach((level, cell) => {
      const share = level / 255;
      setPixel(sheet, cell, [255 * Math.min(1, 1.6 * share), 255 * share ** 2, 90 * (1 - share), level && 60 + 195 * share]);
    });
    show(sheet);
    layer("image").add(sheet.mesh);
    layer("image").visible = false;
  }

  // ---- echoes and their paths
  const picks = [];
  let chosen = null;
  const pathGroup = layer("path");
  function explainedAt(radar, t) {
    return data.explained.find((one) => one.radar === radar && Math.abs(one.t - t) < 1e-3);
  }
  function drawPoints(t) {
    picks.splice(0).forEach((pick) => layer("echoes").remove(pick));
    data.explained.filter((one) => Math.abs(one.t - t) < 1e-3).forEach((one) => one.echoes.forEach((echo) => {
      const ball = new THREE.Mesh(new THREE.SphereGeometry(SHARES.echo * size, 12, 8),
        new THREE.MeshBasicMaterial({ color: radars[one.radar].color }));
      ball.position.set(...echo.point);
      ball.userData = { radar: one.radar, echo };
      picks.push(ball);
      layer("echoes").add(ball);
    }));
  }
  function words(radar, echo) {
    const folded = Math.abs(echo.seen_m - echo.range_m) > 1e-3
      ? ` The pulse interval folds it to ${echo.seen_m.toFixed(2)} m.` : "";
    const bounces = echo.bounces === 1 ? "1 bounce" : `${echo.bounces} bounces`;
    return `${radars[radar].name}: ${echo.path.map(readable).join(" > ")}, ${bounces}, ${echo.range_m.toFixed(2)} m, ` +
      `${echo.db.toFixed(1)} dB.${folded}`;
  }
  function choose(radar, echo) {
    if (chosen && meshes[chosen.echo.object]) {
      const old = meshes[chosen.echo.object];
      old.material.color.set(old.color);
    }
    pathGroup.clear();
    chosen = echo ? { radar, echo } : null;
    $("explanation").textContent = echo ? words(radar, echo) : "";
    if (echo) {
      const from = pose(radars[radar], $("time").valueAsNumber).position;
      const glow = new THREE.MeshBasicMaterial({ color: radars[radar].color, depthTest: false, transparent: true });
      pathGroup.add(cylinder(from.toArray(), echo.point, SHARES.path * size, glow));
      if (meshes[echo.object]) meshes[echo.object].material.color.set(radars[radar].color);
    }
    document.querySelectorAll("#profiles li button").forEach((button) =>
      button.setAttribute("aria-pressed", String(Boolean(echo) && button.echo === echo)));
    drawProfiles();
    render();
  }

  function nameObject(hit) { // what was clicked on, and what the map shows of it
    choose(0, null);
    if (!hit) return;
    const { name, state } = hit.object.userData, [x, y, z] = hit.point.toArray().map((v) => v.toFixed(2));
    $("explanation").textContent = `${readable(name)} at (${x}, ${y}, ${z}) m: ${state || "not in sight at the map's height"}.`;
  }

  // ---- profiles
  const graphs = radars.map((radar, k) => {
    const figure = document.createElement("figure");
    figure.innerHTML = "<figcaption></figcaption><canvas></canvas><ol></ol>";
    figure.firstChild.textContent = `${radar.name}: ${radar.unit === "path_gain" ? "path gain" : "amplitude"} [dB]`;
    figure.firstChild.style.borderBottom = `3px solid ${radar.color}`;
    $("profiles").append(figure);
    const canvas = figure.children[1];
    canvas.addEventListener("click", (event) => pickProfile(k, event));
    return { radar, canvas, list: figure.children[2], bins: radar.levels.length / radar.t.length };
  });
  const xOf = (graph, range_m) => {
    const [low, high] = graph.radar.range_m;
    return 34 + ((range_m - low) / (high - low)) * (graph.canvas.clientWidth - 40);
  };
  function drawProfiles() {
    graphs.forEach((graph, number) => {
      const { canvas, radar, bins } = graph, wide = canvas.clientWidth, tall = canvas.clientHeight;
      const scale = window.devicePixelRatio || 1, pen = canvas.getContext("2d");
      canvas.width = wide * scale;
      canvas.height = tall * scale;
      pen.scale(scale, scale);
      const frame = Math.min($("time").valueAsNumber, radar.t.length - 1), base = tall - 18;
      const y = (share) => base - share * (base - 8);
      pen.font = "11px system-ui, sans-serif";
      pen.fillStyle = css("--soft");
      pen.strokeStyle = css("--line");
      for (let db = 0; db <= radar.span_db; db += 20) {
        pen.fillText(String(radar.top_db - db), 2, y(1 - db / radar.span_db) + 4);
        pen.strokeRect(34, y(1 - db / radar.span_db), wide - 40, 0);
      }
      for (let metre = Math.ceil(radar.range_m[0]); metre <= radar.range_m[1]; metre += 2) {
        pen.fillText(`${metre} m`, xOf(graph, metre) - 8, tall - 4);
      }
      pen.strokeStyle = radar.color;
      pen.lineWidth = 1.6;
      pen.beginPath();
      for (let bin = 0; bin < bins; bin++) {
        const range = radar.range_m[0] + ((radar.range_m[1] - radar.range_m[0]) * bin) / (bins - 1);
        pen.lineTo(xOf(graph, range), y(radar.levels[frame * bins + bin] / 255));
      }
      pen.stroke();
      const found = explainedAt(number, radar.t[frame]);
      for (const echo of found ? found.echoes : []) {
        const at = xOf(graph, echo.seen_m), mine = chosen && chosen.echo === echo;
        pen.fillStyle = mine ? css("--bad") : css("--accent");
        pen.beginPath();
        pen.arc(at, y(Math.min(Math.max((echo.db - radar.top_db) / radar.span_db + 1, 0), 1)), mine ? 6 : 4, 0, 7);
        pen.fill();
      }
      if (radar.nearest_m[frame] >= 0) {
        pen.fillStyle = css("--text");
        pen.fillText("▾", xOf(graph, radar.nearest_m[frame]) - 4, 12);
      }
    });
  }
  function listEchoes(t) {
    graphs.forEach((graph, number) => {
      const found = explainedAt(number, t);
      graph.list.replaceChildren(...(found ? found.echoes.slice(0, 5) : []).map((echo) => {
        const item = document.createElement("li"), button = document.createElement("button");
        button.type = "button";
        button.echo = echo;
        button.textContent = `${echo.db.toFixed(1)} dB  ${echo.seen_m.toFixed(2)} m  ${echo.path.map(readable).join(" > ")}`;
        button.addEventListener("click", () => choose(number, echo));
        item.append(button);
        return item;
      }));
    });
  }
  function pickProfile(number, event) {
    const graph = graphs[number], found = explainedAt(number, graph.radar.t[$("time").valueAsNumber]);
    const x = event.offsetX;
    const near = (found ? found.echoes : [])
      .map((echo) => ({ echo, off: Math.abs(xOf(graph, echo.seen_m) - x) })).sort((a, b) => a.off - b.off)[0];
    if (near && near.off < 12) choose(number, near.echo);
    else if (!found) goTo(nearestExplained(graph.radar.t[$("time").valueAsNumber]));
  }

  // ---- time
  function pose(path, frame) {
    const k = Math.min(frame, path.t.length - 1);
    return { position: new THREE.Vector3(...path.position.subarray(3 * k, 3 * k + 3)),
      turn: new THREE.Quaternion(...path.quat.subarray(4 * k, 4 * k + 4)) };
  }
  function render() {
    if (!renderer) return;
    renderer.render(scene, camera);
    const { clientWidth, clientHeight } = $("stage"), at = new THREE.Vector3();
    for (const { element, place } of labels) {
      at.copy(place).project(camera);
      element.hidden = !layers.scale.visible || at.z > 1 || Math.abs(at.x) > 1 || Math.abs(at.y) > 1;
      element.style.left = `${((at.x + 1) / 2) * clientWidth}px`;
      element.style.top = `${((1 - at.y) / 2) * clientHeight}px`;
    }
  }
  function goTo(frame) {
    $("time").value = String(frame);
    const t = radars[0].t[frame], { position, turn } = pose(flight, frame);
    drone.position.copy(position);
    drone.quaternion.copy(turn);
    flown.count = Math.min(frame, flight.t.length - 1);
    radars.forEach((radar, k) => {
      const at = pose(radar, frame);
      for (const thing of [beams[k], arcs[k]]) {
        thing.position.copy(at.position);
        thing.quaternion.copy(at.turn);
      }
      const range = radar.nearest_m[Math.min(frame, radar.t.length - 1)];
      arcs[k].visible = range > 0;
      arcs[k].scale.setScalar(Math.max(range, 1e-3));
    });
    if (data.map) showMap(data.map, frame === frames - 1 ? Infinity : t);
    $("clock").textContent = `${t.toFixed(1)} s of ${end.toFixed(1)} s`;
    document.body.dataset.drone = drone.position.toArray().map((v) => v.toFixed(2)).join(" ");
    drawPoints(t);
    listEchoes(t);
    choose(0, null);
  }
  const instants = [...new Set(data.explained.map((one) => one.t))].sort((a, b) => a - b);
  const frameAt = (t) => radars[0].t.reduce((best, value, k) => Math.abs(value - t) < Math.abs(radars[0].t[best] - t) ? k : best, 0);
  const nearestExplained = (t) => instants.length
    ? frameAt(instants.reduce((a, b) => (Math.abs(b - t) < Math.abs(a - t) ? b : a))) : frameAt(t);
  let playing = null;
  function play(on) {
    clearInterval(playing);
    playing = null;
    $("play").textContent = on ? "Pause" : "Play";
    if (!on) return;
    if ($("time").valueAsNumber >= frames - 1) goTo(0);
    playing = setInterval(() => {
      const next = $("time").valueAsNumber + 1;
      goTo(Math.min(next, frames - 1));
      if (next >= frames - 1) play(false);
    }, 66);
  }

  // ---- everything together
  if (data.world) drawWorld(data.world);
  drawFlight();
  if (data.map) drawMap(data.map);
  if (data.image) drawImage(data.image);
  if (data.unmapped && data.unmapped.length) drawUnmapped(data.unmapped, Math.max(0.006 * size, 0.05));
  drawScale();
  if (renderer) drawLegend();
  for (const name of ["world", "flight", "beams", "echoes", "map", "not mapped", "image", "scale"].filter((one) => layers[one])) {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox";
    box.checked = layers[name].visible;
    box.addEventListener("change", () => { layers[name].visible = box.checked; render(); });
    label.append(box, ` ${name}`);
    $("layers").append(label);
  }
  $("time").max = String(frames - 1);
  $("time").addEventListener("input", () => { play(false); goTo($("time").valueAsNumber); });
  $("play").addEventListener("click", () => play(!playing));
  $("next").hidden = !instants.length;
  $("next").addEventListener("click", () => {
    play(false);
    const now = radars[0].t[$("time").valueAsNumber];
    goTo(frameAt(instants.find((t) => t > now + 1e-3) ?? instants[0]));
  });
  instants.forEach((t) => {
    const tick = document.createElement("button");
    tick.type = "button";
    tick.title = `explained frame at ${t.toFixed(1)} s`;
    tick.style.left = `${(100 * frameAt(t)) / Math.max(frames - 1, 1)}%`;
    tick.addEventListener("click", () => { play(false); goTo(frameAt(t)); });
    $("ticks").append(tick);
  });

  function resize() {
    if (!renderer) return;
    const { clientWidth, clientHeight } = $("stage");
    renderer.setPixelRatio(window.devicePixelRatio || 1);
    renderer.setSize(clientWidth, clientHeight, false);
    camera.aspect = clientWidth / clientHeight;
    camera.updateProjectionMatrix();
    drawProfiles();
    render();
  }
  function lookAtAll() { // from outside and above, as near as the whole world fits
    const middle = new THREE.Vector3(...low.map((v, k) => (v + high[k]) / 2));
    const away = new THREE.Vector3(-0.32, -0.85, 0.62).normalize();
    const box = [0, 1, 2, 3, 4, 5, 6, 7].flatMap((k) => [0, 1, 2].map((axis) => ((k >> axis) & 1 ? high : low)[axis]));
    const corners = labels.map(({ place }) => place.clone()), shapes = [flight.position,
      ...(data.world ? data.world.objects.map((one) => one.corners) : [new Float32Array(box)])];
    for (const shape of shapes) {
      const stride = 3 * Math.max(1, Math.floor(shape.length / 900));
      for (let k = 0; k + 2 < shape.length; k += stride) corners.push(new THREE.Vector3(...shape.subarray(k, k + 3)));
    }
    camera.near = size / 500;
    camera.far = size * 20;
    camera.quaternion.setFromRotationMatrix(new THREE.Matrix4().lookAt(away, new THREE.Vector3(), camera.up));
    const half = 0.97 * Math.tan((camera.fov * Math.PI) / 360), turn = camera.quaternion.clone().invert();
    for (let step = 0; step < 8; step++) {
      const local = corners.map((corner) => corner.clone().sub(middle).applyQuaternion(turn));
      const distance = local.reduce((far, p) =>
        Math.max(far, Math.abs(p.x) / (half * camera.aspect) + p.z, Math.abs(p.y) / half + p.z), 0);
      const spots = local.map((p) => [p.x / (distance - p.z), p.y / (distance - p.z)]);
      const off = [0, 1].map((k) => (Math.max(...spots.map((q) => q[k])) + Math.min(...spots.map((q) => q[k]))) / 2);
      middle.add(new THREE.Vector3(off[0] * distance, off[1] * distance, 0).applyQuaternion(camera.quaternion));
      camera.position.copy(middle).addScaledVector(away, distance);
    }
    camera.updateProjectionMatrix();
    return middle;
  }
  resize();
  const target = lookAtAll();
  if (renderer) {
    const controls = new THREE.OrbitControls(camera, $("view"));
    controls.target.copy(target);
    controls.update();
    controls.addEventListener("change", render);
    document.querySelectorAll("tr[data-object]").forEach((row) => { // its row takes the camera to an object
      const thing = data.world && data.world.objects.find((one) => one.name === row.dataset.object);
      if (!thing || !(thing.corners.length + thing.wires.length)) return;
      const fly = () => {
        const ends = [0, 1, 2].map((axis) => {
          const values = [thing.corners, thing.wires].flatMap((points) => [...points].filter((_, k) => k % 3 === axis));
          return [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))];
        });
        const middle = new THREE.Vector3(...ends.map(([a, b]) => (a + b) / 2));
        const away = camera.position.clone().sub(controls.target).normalize();
        const far = Math.max(1.2 * Math.hypot(...ends.map(([a, b]) => b - a)), 0.15 * size);
        controls.target.copy(middle);
        camera.position.copy(middle).addScaledVector(away, far);
        controls.update();
        $("explanation").textContent = `${readable(row.dataset.object)}: ${row.dataset.state}.`;
        $("replay").scrollIntoView({ block: "nearest" });
        render();
      };
      row.tabIndex = 0;
      row.addEventListener("click", fly);
      row.addEventListener("keydown", (event) => { if (event.key === "Enter") fly(); });
    });
    const caster = new THREE.Raycaster();
    let pressed = null;
    $("view").addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
    $("view").addEventListener("pointerup", (event) => {
      if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4) return;
      const box = $("view").getBoundingClientRect();
      caster.setFromCamera(new THREE.Vector2(
        (2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height), camera);
      const hit = caster.intersectObjects(layers.echoes.visible ? picks : [])[0];
      if (hit) choose(hit.object.userData.radar, hit.object.userData.echo);
      else nameObject(layers.world && layers.world.visible ? caster.intersectObjects(solids)[0] : null);
    });
  }
  $("theme").hidden = false;
  $("theme").addEventListener("click", () => {
    const root = document.documentElement, dark = root.dataset.theme
      ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    drawProfiles();
    render();
  });
  window.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step || document.activeElement !== $("view")) return;
    event.preventDefault();
    play(false);
    goTo(Math.min(Math.max($("time").valueAsNumber + step, 0), frames - 1));
  });
  window.addEventListener("resize", resize);
  window.addEventListener("beforeprint", () => { drawProfiles(); render(); });
  goTo(frames - 1);
  document.body.dataset.ready = "true";
})();
