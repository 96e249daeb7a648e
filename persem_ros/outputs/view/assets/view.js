'use strict';
// The page: a camera over tiles, colours, a click that asks why, and a look every two seconds at
// whether the map has changed. Drawn only when something is new. Texts from the map are shown as text.
(() => {
  const byId = id => document.getElementById(id);
  const canvas = byId('map'), note = byId('note'), PERIOD = 2000, PAUSE = 400, PIXELS = 2, OBSERVED = 16;
  // While the view moves and a frame takes longer than SLOW ms, as without a GPU, a quarter of the
  // pixels is drawn, of tiles COARSE times as coarse; REST ms after the last move all is sharp again.
  const SLOW = 80, COARSE = 2, REST = 350;
  let info, renderer, camera, controls, scene, uniforms, material, marks, paths;
  let shown = null, next = null, newest = null, waiting = false, fresh = false, drawn = 0, later = 0;
  let moving = false, coarse = false, resting = 0;

  function alone(text) {
    note.textContent = text;
    note.className = 'alone';
    canvas.hidden = true;
  }

  async function asked(name) {
    const answer = await fetch(name);
    if (!answer.ok) throw new Error((await answer.text()).trim());
    return answer.json();
  }

  function texture(colors, width, height) {
    const bytes = new Uint8Array(4 * width * height);
    colors.forEach(([at, color]) => bytes.set([...color, 255], 4 * at));
    const result = new TILES.DataTexture(bytes, width, height);
    result.needsUpdate = true;
    return result;
  }

  function smooth(ramp) {
    return Array.from({length: 256}, (_, i) => {
      const at = i / 255 * (ramp.length - 1), k = Math.min(ramp.length - 2, Math.floor(at));
      return [i, [0, 1, 2].map(c => ramp[k][c] + (ramp[k + 1][c] - ramp[k][c]) * (at - k))];
    });
  }

  function begin() {
    try {
      renderer = new TILES.WebGLRenderer({canvas, antialias: false, alpha: true});
    } catch {
      alone('This page draws with WebGL 2, which this browser does not offer or has switched off; ' +
            'try another one, or persem map export --ply for a desktop program.');
      return false;
    }
    renderer.outputColorSpace = 'srgb-linear';
    renderer.setPixelRatio(sharpness());
    const most = OBSERVED * Math.log2(Math.max(2, info.frames));
    uniforms = {
      turn: {value: new TILES.Matrix3()}, pixels: {value: 1}, reach: {value: 1},
      everywhere: {value: 0}, seconds: {value: Math.max(1e-3, info.seconds)},
      most: {value: most}, mode: {value: 0}, asking: {value: 0},
      palette: {value: texture(info.classes.map(c => [c.id, c.color]), 256, 256)},
      ramp: {value: texture(smooth(info.ramp), 256, 1)},
      sources: {value: texture(info.sources.map((s, i) => [i, s.color]), info.sources.length, 1)},
    };
    material = new TILES.RawShaderMaterial({
      glslVersion: TILES.GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms});
    scene = new TILES.Scene();
    marks = new TILES.Group();
    paths = new TILES.Group();
    scene.add(marks, paths);
    camera = new TILES.PerspectiveCamera(45, 1, 1, 1e4);
    camera.up.set(0, 0, 1);
    controls = new TILES.OrbitControls(camera, canvas);
    controls.enableDamping = false;
    controls.zoomToCursor = true;
    controls.screenSpacePanning = false;
    controls.listenToKeyEvents(canvas);
    controls.addEventListener('change', draw);
    controls.addEventListener('start', () => { moving = true; clearTimeout(resting); });
    controls.addEventListener('end', () => { clearTimeout(resting); resting = setTimeout(rest, REST); });
    new ResizeObserver(draw).observe(canvas);
    canvas.addEventListener('webglcontextrestored', draw);
    return true;
  }

  const sharpness = () => Math.min(devicePixelRatio || 1, 1.5) * (coarse ? 0.5 : 1);

  function rest() {
    moving = false;
    if (coarse) draw();
  }

  // Tiles of one state of the map; the material of what is loaded is ours.
  function tilesOf(generation) {
    const tiles = new TILES.TilesRenderer('tileset.json?' + generation);
    tiles.errorTarget = PIXELS;
    tiles.lruCache.maxBytesSize = 256 * 2 ** 20;
    tiles.lruCache.minBytesSize = 192 * 2 ** 20;
    tiles.downloadQueue.maxJobsPerOrigin = 4;
    tiles.setCamera(camera);
    tiles.generation = generation;
    tiles.addEventListener('load-model', ({scene: model}) => {
      model.traverse(part => {
        if (!part.isPoints) return;
        part.material.dispose();
        part.material = material;
        part.frustumCulled = false;
      });
      update();
    });
    for (const kind of ['needs-update', 'load-tileset', 'tiles-load-end']) {
      tiles.addEventListener(kind, update);
    }
    tiles.addEventListener('load-error', ({error}) => { console.warn(String(error)); update(); });
    return tiles;
  }

  const idle = tiles => tiles.root && tiles.loadProgress === 1 && tiles.visibleTiles.size > 0;

  function fit() {
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width || !height) return false;
    const ratio = sharpness();
    if (ratio !== renderer.getPixelRatio()) renderer.setPixelRatio(ratio);
    if (canvas.width !== Math.floor(width * ratio) ||
        canvas.height !== Math.floor(height * ratio)) {
      renderer.setSize(width, height, false);
      camera.aspect = width / height;
    }
    const away = camera.position.distanceTo(controls.target);
    camera.near = Math.max(away / 100, 0.2 * info.voxelSize);
    camera.far = away + 4 * radius();
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    return true;
  }

  // Something else is to be seen. What only loads is drawn a few times a second: without a GPU a
  // picture takes longer than a tile.
  function draw() {
    fresh = true;
    update();
  }

  function update() {
    if (waiting) return;
    waiting = true;
    const asked = performance.now();
    requestAnimationFrame(() => {
      waiting = false;
      coarse = moving && (coarse || performance.now() - asked > SLOW);
      if (!fit()) return;
      for (const tiles of [shown, next]) {
        if (!tiles) continue;
        tiles.errorTarget = coarse ? COARSE * PIXELS : PIXELS;
        tiles.setResolutionFromRenderer(camera, renderer);
        tiles.group.updateMatrixWorld();
        tiles.update();
      }
      if (next && idle(next)) swap();
      const ready = idle(shown || next);
      if (!fresh && !ready && performance.now() - drawn < PAUSE) {
        later = later || setTimeout(() => { later = 0; update(); }, PAUSE);
        return;
      }
      uniforms.turn.value.setFromMatrix4(camera.matrixWorld);
      uniforms.reach.value = camera.far;
      uniforms.pixels.value = canvas.height / 2 / Math.tan(camera.fov * Math.PI / 360);
      renderer.render(scene, camera);
      fresh = false;
      drawn = performance.now();
      tell(ready);
    });
  }

  function swap() {
    if (shown) {
      scene.remove(shown.group);
      shown.dispose();
    }
    [shown, next] = [next, null];
    scene.add(shown.group);
  }

  function tell(ready) {
    const data = document.body.dataset;
    const points = renderer.info.render.points;
    if (points && !data.first) data.first = Math.round(performance.now());
    data.points = points;
    data.ready = ready ? Math.round(performance.now()) : '';
    note.textContent = `${points.toLocaleString('en')} points drawn` +
      (data.ready ? '' : ' · loading');
  }

  function radius() {
    return 0.5 * Math.hypot(...info.high.map((v, k) => v - info.low[k])) + info.voxelSize;
  }

  function look(x, y, z) {
    const half = info.high.map((v, k) => (v - info.low[k]) / 2);
    const up = Math.tan(camera.fov * Math.PI / 360);
    const wide = up * canvas.clientWidth / Math.max(1, canvas.clientHeight);
    controls.target.set(...info.high.map((v, k) => v - half[k]));
    camera.position.set(x, y, z).add(controls.target);
    camera.lookAt(controls.target);
    camera.updateMatrixWorld();
    const axes = [0, 1, 2].map(k => new TILES.Vector3().setFromMatrixColumn(camera.matrixWorld, k));
    let away = 0;
    for (let corner = 0; corner < 8; corner++) {
      const at = new TILES.Vector3(...half.map((v, k) => corner >> k & 1 ? v : -v));
      const [r, u, b] = axes.map(axis => at.dot(axis));
      away = Math.max(away, b + Math.max(Math.abs(r) / wide, Math.abs(u) / up));
    }
    camera.position.copy(controls.target).addScaledVector(axes[2], away);
    controls.minDistance = 2 * info.voxelSize;
    controls.maxDistance = 20 * radius();
    controls.update();
    draw();
  }

  // ---- what is asked by a click ----------------------------------------------------------------
  function placeAt(x, y) {
    const {width, height} = canvas, around = 4, side = 2 * around + 1;
    const target = new TILES.WebGLRenderTarget(width, height);
    const left = Math.max(0, Math.min(width - side, Math.round(x) - around));
    const low = Math.max(0, Math.min(height - side, height - 1 - Math.round(y) - around));
    target.scissorTest = true;
    target.scissor.set(left, low, side, side);
    const bytes = new Uint8Array(4 * side * side);
    marks.visible = paths.visible = false;
    uniforms.asking.value = 1;
    renderer.setRenderTarget(target);
    renderer.clear();
    renderer.render(scene, camera);
    renderer.readRenderTargetPixels(target, left, low, side, side, bytes);
    renderer.setRenderTarget(null);
    target.dispose();
    uniforms.asking.value = 0;
    marks.visible = paths.visible = true;
    let best = null;
    for (let i = 0; i < side * side; i++) {
      if (bytes[4 * i + 3] !== 255) continue;
      const px = left + i % side, py = height - 1 - (low + Math.floor(i / side));
      const off = Math.hypot(px - x, py - y);
      if (best && best.off <= off) continue;
      const far = bytes[4 * i] << 16 | bytes[4 * i + 1] << 8 | bytes[4 * i + 2];
      best = {off, px, py, away: far / 16777215 * camera.far};
    }
    if (!best) return null;
    const ray = new TILES.Vector3(2 * (best.px + 0.5) / width - 1, 1 - 2 * (best.py + 0.5) / height, 0.5)
      .unproject(camera).sub(camera.position).normalize();
    const pixel = 2 * best.away / (height / Math.tan(camera.fov * Math.PI / 360));
    return {point: camera.position.clone().addScaledVector(ray, best.away + 0.05 * info.voxelSize),
            within: Math.max(2, Math.min(64, 2 * PIXELS * pixel / info.voxelSize))};
  }

  async function ask(x, y) {
    const found = placeAt(x, y);
    if (!found) return;
    byId('why').hidden = false;
    why('…', '');
    const words = ['x', 'y', 'z'].map(axis => `${axis}=${found.point[axis].toFixed(4)}`);
    try {
      const answer = await asked(`explain.json?${words.join('&')}&within=${found.within.toFixed(1)}`);
      why(answer.name, answer.text);
      mark(answer);
    } catch (error) {
      why('Nothing to tell', error.message);
      marks.clear();
      draw();
    }
  }

  // The sentences, and below them the tables.
  function why(name, text) {
    const parts = text.split('\n\n');
    byId('why-name').textContent = name;
    byId('why-text').textContent = parts.slice(0, 2).join('\n');
    byId('why-tables').textContent = parts.slice(2).join('\n\n');
    byId('why-more').hidden = parts.length < 3;
  }

  function lines(corners, colors) {
    const geometry = new TILES.BufferGeometry();
    geometry.setAttribute('position', new TILES.BufferAttribute(Float32Array.from(corners), 3));
    geometry.setAttribute('color', new TILES.BufferAttribute(Float32Array.from(colors), 3));
    const result = new TILES.LineSegments(
      geometry, new TILES.LineBasicMaterial({vertexColors: true, depthTest: false}));
    result.frustumCulled = false;
    result.renderOrder = 1;
    return result;
  }

  // The voxel, and the rays from which it was seen, in the colour of what they said.
  function mark(answer) {
    const edge = info.voxelSize, box = [], rays = [], colors = [];
    for (let axis = 0; axis < 3; axis++) {
      for (let k = 0; k < 4; k++) {
        const from = [0, 0, 0];
        from[(axis + 1) % 3] = k & 1;
        from[(axis + 2) % 3] = k >> 1;
        const to = [...from];
        to[axis] = 1;
        for (const end of [from, to]) box.push(...end.map((v, i) => answer.corner[i] + v * edge));
      }
    }
    answer.eyes.forEach((eye, k) => {
      rays.push(...eye, ...answer.corner.map(v => v + edge / 2));
      for (let end = 0; end < 2; end++) colors.push(...answer.colors[k].map(v => v / 255));
    });
    marks.clear();
    marks.add(lines(rays, colors), lines(box, box.map(() => 1)));
    draw();
  }

  function listen() {
    let down = null;
    canvas.addEventListener('pointerdown', event => { down = event.isPrimary ? event : null; });
    canvas.addEventListener('pointerup', event => {
      if (!down || event.button || Math.hypot(event.clientX - down.clientX,
                                              event.clientY - down.clientY) > 4) return;
      const box = canvas.getBoundingClientRect(), ratio = canvas.width / box.width;
      ask((event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio);
    });
    byId('close').onclick = () => { byId('why').hidden = true; marks.clear(); draw(); };
    addEventListener('keydown', event => { if (event.key === 'Escape') byId('close').click(); });
    byId('whole').onclick = () => look(-0.55, -1, 0.95);
    byId('above').onclick = () => look(0, -0.001, 1);
    byId('modes').onchange = event => {
      uniforms.mode.value = +event.target.value;
      key();
      draw();
    };
    if (innerWidth <= 640) byId('panel').open = false;
  }

  // ---- the key to the colours ------------------------------------------------------------------
  function row(tag, color, text, small) {
    const result = document.createElement(tag), patch = document.createElement('i');
    const name = document.createElement('span'), more = document.createElement('small');
    result.className = 'row';
    patch.style.background = `rgb(${color.join()})`;
    name.textContent = text;
    more.textContent = small || '';
    result.append(patch, name, more);
    return result;
  }

  function classes() {
    const bytes = uniforms.palette.value.image.data;
    return info.classes.map(item => {
      const button = row('button', item.color, item.name);
      button.type = 'button';
      button.setAttribute('aria-pressed', bytes[4 * item.id + 3] > 0);
      button.onclick = () => {
        const on = button.getAttribute('aria-pressed') !== 'true';
        button.setAttribute('aria-pressed', on);
        bytes[4 * item.id + 3] = on ? 255 : 0;
        uniforms.palette.value.needsUpdate = true;
        // What a hidden class covered is to be seen now.
        uniforms.everywhere.value = +!!byId('key').querySelector('[aria-pressed="false"]');
        draw();
      };
      return button;
    });
  }

  function gradient(low, high) {
    const strip = document.createElement('canvas'), ends = document.createElement('div');
    strip.className = 'ramp';
    strip.width = 256;
    strip.height = 1;
    const context = strip.getContext('2d'), data = uniforms.ramp.value.image.data;
    for (let i = 0; i < 256; i++) {
      context.fillStyle = `rgb(${data[4 * i]},${data[4 * i + 1]},${data[4 * i + 2]})`;
      context.fillRect(i, 0, 1, 1);
    }
    ends.className = 'ends';
    for (const text of [low, high]) {
      const end = document.createElement('span');
      end.textContent = text;
      ends.append(end);
    }
    return [strip, ends];
  }

  function key() {
    const mode = uniforms.mode.value;
    const time = s => new Date(info.start + 1000 * s).toISOString().slice(0, 19).replace('T', ' ');
    byId('key').replaceChildren(...(
      mode === 0 ? classes()
      : mode === 1 ? gradient('0 unsure', '1 sure')
      : mode === 2 ? gradient('1', `${Math.max(2, info.frames).toLocaleString('en')} (logarithmic)`)
      : mode === 3 ? info.sources.map(s => row('div', s.color, s.name, s.text))
      : mode === 4 ? gradient(time(0), time(info.seconds))
      : [row('div', [255, 89, 26], 'moved away'), row('div', [128, 128, 128], 'there')]));
  }

  // ---- what changes ----------------------------------------------------------------------------
  async function facts() {
    const before = info;
    info = await asked('info.json');
    if (before && String(before.anchor) !== String(info.anchor)) location.reload();
    document.title = byId('name').textContent = info.name;
    byId('size').textContent = `${info.voxels.toLocaleString('en')} voxels of ${info.voxelSize} m, ` +
      `${info.frames.toLocaleString('en')} frames, in ${info.mapFrame}`;
    if (before) {
      const data = uniforms.palette.value.image.data;
      for (const item of info.classes) {
        if (!before.classes.some(old => old.id === item.id)) data.set([...item.color, 255], 4 * item.id);
      }
      uniforms.palette.value.needsUpdate = true;
      uniforms.seconds.value = Math.max(1e-3, info.seconds);
      uniforms.most.value = OBSERVED * Math.log2(Math.max(2, info.frames));
      key();
    }
  }

  async function tracks() {
    const found = await asked('tracks.json');
    paths.clear();
    for (const track of found) {
      const line = new TILES.BufferGeometry();
      line.setAttribute('position', new TILES.BufferAttribute(Float32Array.from(track.flat()), 3));
      const path = new TILES.Line(line, new TILES.LineBasicMaterial({color: 0xffffff}));
      path.frustumCulled = false;
      paths.add(path);
    }
    const last = found.length ? found[found.length - 1].at(-1) : null;
    if (last && newest && byId('follow').checked) {
      const moved = new TILES.Vector3(...last).sub(newest);
      controls.target.add(moved);
      camera.position.add(moved);
      controls.update();
    }
    newest = last && new TILES.Vector3(...last);
    draw();
  }

  async function poll() {
    try {
      const {generation} = await asked('changes.json');
      const known = (next || shown).generation;
      if (generation !== known && !next) {
        await facts();
        await tracks();
        next = tilesOf(info.generation);
        draw();
      }
    } catch (error) {
      note.textContent = `The map cannot be read any more: ${error.message}`;
    }
    setTimeout(poll, document.hidden ? 5 * PERIOD : PERIOD);
  }

  async function open() {
    await facts();
    if (!begin()) return;
    listen();
    key();
    look(-0.55, -1, 0.95);
    shown = tilesOf(info.generation);
    scene.add(shown.group);
    draw();
    await tracks();
    setTimeout(poll, PERIOD);
  }

  open().catch(error => alone(`The map cannot be shown: ${error.message}`));
})();
