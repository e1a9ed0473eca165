// 3-D view and camera images of the drive view. three.js is that of NiceGUI; no other server is contacted.
"use strict";
window.headlandSurroundings = (() => {
  const CAPACITY = 16384; // points
  const HEIGHTS = [[0.12, "#8a7a5c"], [0.5, "#1f6fb0"], [Infinity, "#0b2f6f"]]; // upper end (m) and colour of points
  const COLORS = window.headland.COLORS, OTHER = "#333333", FIELD = "#a30014", MACHINE = ["#2c6e3f", "#7a5a2a"];
  const byId = (id) => document.getElementById(id);
  let pane = "map", space = null, camera = null;

  function choose(name) {
    pane = name;
    document.querySelectorAll("[data-pane]").forEach((one) => one.setAttribute("aria-pressed", String(one.dataset.pane === name)));
    byId("map-pane").hidden = name !== "map";
    byId("space").hidden = name !== "space";
    byId("camera").hidden = !name.startsWith("camera/");
    window.headlandControls.send({action: "watch", value: name});
    if (name === "space") open();
  }

  function open() {
    space ||= make().catch((error) => { byId("space-note").textContent = byId("space-note").dataset.failed; console.warn(error); return null; });
    return space;
  }

  async function make() {
    const {THREE, OrbitControls, CSS2DRenderer, CSS2DObject} = await import("nicegui-scene");
    const box = byId("space"), scene = new THREE.Scene(), eye = new THREE.PerspectiveCamera(60, 1, 0.1, 300);
    const renderer = new THREE.WebGLRenderer({antialias: true}), labels = new CSS2DRenderer();
    eye.up.set(0, 0, 1); eye.position.set(-14, 0, 9);
    scene.background = new THREE.Color("#f4f1ea");
    const grid = new THREE.GridHelper(80, 16, "#9a9a9a", "#c8c4ba");
    grid.rotation.x = Math.PI / 2;
    const geometry = new THREE.BufferGeometry(), place = new Float32Array(3 * CAPACITY), color = new Float32Array(3 * CAPACITY);
    geometry.setAttribute("position", new THREE.BufferAttribute(place, 3)); geometry.setAttribute("color", new THREE.BufferAttribute(color, 3));
    geometry.setDrawRange(0, 0);
    const cloud = new THREE.Points(geometry, new THREE.PointsMaterial({size: 2.5, sizeAttenuation: false, vertexColors: true}));
    cloud.frustumCulled = false;
    const moving = new THREE.Group(), paints = HEIGHTS.map(([high, paint]) => [high, new THREE.Color(paint)]);
    scene.add(grid, cloud, moving);
    labels.domElement.className = "hl-labels";
    box.append(renderer.domElement, labels.domElement);
    const controls = new OrbitControls(eye, labels.domElement);
    controls.target.set(5, 0, 0); controls.maxPolarAngle = 0.49 * Math.PI; controls.minDistance = 2; controls.maxDistance = 120; controls.update();

    function draw() { renderer.render(scene, eye); labels.render(scene, eye); }

    function fit() {
      const {width, height} = box.getBoundingClientRect();
      if (!width || !height) return;
      renderer.setPixelRatio(Math.min(2, window.devicePixelRatio || 1));
      renderer.setSize(width, height); labels.setSize(width, height);
      eye.aspect = width / height; eye.updateProjectionMatrix(); draw();
    }

    function edges(size, at, yaw, paint) {
      const shape = new THREE.BoxGeometry(...size.map((one) => Math.max(0.05, one))), lines = new THREE.EdgesGeometry(shape);
      const found = new THREE.LineSegments(lines, new THREE.LineBasicMaterial({color: paint}));
      shape.dispose();
      found.position.set(...at); found.rotation.z = yaw;
      return found;
    }

    function label(track) {
      const element = document.createElement("span");
      element.textContent = track.text; element.className = "hl-label";
      const found = new CSS2DObject(element);
      found.position.set(track.at[0], track.at[1], track.at[2] + 0.5 * track.size[2] + 0.3);
      return found;
    }

    function clear() {
      moving.traverse((one) => { if (one.geometry) { one.geometry.dispose(); one.material.dispose(); } });
      while (moving.children.length) moving.remove(moving.children[0]); // labels leave the page with their objects
    }

    function showPoints(text) {
      const bytes = Uint8Array.from(atob(text), (one) => one.charCodeAt(0)), values = new Int16Array(bytes.buffer);
      const count = Math.min(CAPACITY, values.length / 3);
      for (let k = 0; k < count; k++) {
        for (let j = 0; j < 3; j++) place[3 * k + j] = 0.01 * values[3 * k + j];
        paints.find(([high]) => place[3 * k + 2] < high)[1].toArray(color, 3 * k);
      }
      geometry.setDrawRange(0, count);
      geometry.attributes.position.needsUpdate = geometry.attributes.color.needsUpdate = true;
      return count;
    }

    function show(shown) {
      clear();
      box.dataset.points = showPoints(shown.points); box.dataset.tracks = shown.tracks.length;
      shown.bodies.forEach(([x, y, z, l, w, h, yaw], k) => moving.add(edges([l, w, h], [x, y, z], yaw, MACHINE[k % 2])));
      shown.tracks.forEach((track) => {
        moving.add(edges(track.size, track.at, track.yaw, COLORS[track.class] || OTHER));
        if (track.is_shown) moving.add(label(track));
      });
      if (shown.field.length > 2) {
        const outline = new THREE.BufferGeometry().setFromPoints(shown.field.map(([x, y]) => new THREE.Vector3(x, y, 0.05)));
        moving.add(new THREE.LineLoop(outline, new THREE.LineBasicMaterial({color: FIELD})));
      }
      byId("space-note").hidden = true;
      draw();
    }

    controls.addEventListener("change", draw);
    new ResizeObserver(fit).observe(box);
    fit();
    return {show};
  }

  function showCamera(shown) {
    const image = new Image();
    image.onload = () => { camera = {image, ...shown}; drawCamera(); };
    image.src = "data:image/jpeg;base64," + shown.jpeg;
  }

  function drawCamera() {
    const canvas = byId("camera-image");
    if (!canvas || !camera) return; // the view has changed while the image was decoded
    const {width, height} = canvas.getBoundingClientRect();
    if (!width || !height) return;
    const ratio = Math.min(2, window.devicePixelRatio || 1), context = canvas.getContext("2d");
    canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
    const scale = Math.min(canvas.width / camera.size[0], canvas.height / camera.size[1]);
    const left = 0.5 * (canvas.width - scale * camera.size[0]), top = 0.5 * (canvas.height - scale * camera.size[1]);
    context.drawImage(camera.image, left, top, scale * camera.size[0], scale * camera.size[1]);
    context.font = `600 ${16 * ratio}px sans-serif`;
    camera.boxes.forEach(({box, text, ...one}) => {
      const [x0, y0, x1, y1] = box.map((value, k) => (k % 2 ? top : left) + scale * value);
      context.strokeStyle = "#fff"; context.lineWidth = 5 * ratio; context.strokeRect(x0, y0, x1 - x0, y1 - y0);
      context.strokeStyle = COLORS[one.class] || OTHER; context.lineWidth = 3 * ratio; context.strokeRect(x0, y0, x1 - x0, y1 - y0);
      if (!one.is_shown) return;
      const high = 22 * ratio, y = Math.max(0, y0 - high);
      context.fillStyle = "#fff"; context.fillRect(x0, y, context.measureText(text).width + 8 * ratio, high);
      context.fillStyle = "#111"; context.fillText(text, x0 + 4 * ratio, y + 17 * ratio);
    });
    byId("camera").dataset.boxes = camera.boxes.length;
    byId("camera-note").hidden = true;
  }

  function update(shown) {
    if (shown.space && pane === "space") open().then((view) => view && view.show(shown.space));
    if (shown.camera && pane === shown.camera.topic) showCamera(shown.camera);
  }

  document.addEventListener("click", (event) => {
    const button = event.target.closest("[data-pane]");
    if (button) choose(button.dataset.pane);
  });
  window.addEventListener("resize", drawCamera);
  return {update};
})();
