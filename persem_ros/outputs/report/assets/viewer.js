'use strict';
// The map in three dimensions: every voxel is one point whose fragments are traced against its
// cube, so that 400 000 cubes cost no more than 400 000 points. Drawn only when something changes.
(() => {
  const box = document.getElementById('viewer'), canvas = box.querySelector('canvas');
  const note = document.getElementById('viewer-note'), start = document.getElementById('start');
  const map = JSON.parse(document.getElementById('voxels').textContent);
  const touch = matchMedia('(pointer: coarse)').matches;
  start.hidden = !touch;

  const VERTEX = `
    precision highp float; precision highp int; precision highp sampler2D;
    in vec4 cell; in vec4 info;
    uniform mat4 modelViewMatrix, projectionMatrix;
    uniform vec3 middle, eye; uniform vec2 cut; uniform float pixels, most, everywhere; uniform int mode;
    uniform sampler2D palette, ramp, sources;
    flat out vec3 color, toward, open; flat out float sprite, lit;
    void main() {
      vec3 center = cell.xyz + 0.5 - middle;
      int label = int(cell.w);
      vec4 own = texelFetch(palette, ivec2(label & 255, label >> 8), 0);
      float height = clamp((cell.z - cut.x) / max(cut.y - cut.x, 1.0), 0.0, 1.0);
      float value = mode == 1 ? info.x : mode == 2 ? info.y : 255.0 * height;
      color = mode == 0 ? own.rgb : mode == 3 ? texelFetch(sources, ivec2(int(info.z), 0), 0).rgb
        : texelFetch(ramp, ivec2(int(value), 0), 0).rgb;
      toward = eye - center;
      // The faces on the camera's side that no other voxel covers, and their mean brightness.
      ivec3 bit = ivec3(0, 2, 4) + ivec3(greaterThan(toward, vec3(0.0)));
      open = vec3((ivec3(int(info.w)) >> bit) & 1);
      if (cell.z + 1.0 > most) open.z = 1.0;
      if (open == vec3(0.0)) open = vec3(everywhere);
      vec3 area = open * abs(toward);
      lit = dot(area, vec3(0.8, 0.68, toward.z < 0.0 ? 0.55 : 1.0)) /
            max(area.x + area.y + area.z, 1e-6);
      open = max(open, vec3(everywhere));
      vec4 seen = modelViewMatrix * vec4(center, 1.0);
      gl_Position = projectionMatrix * seen;
      sprite = clamp(2.1 * pixels / max(-seen.z, 0.01), 1.5, 500.0);
      gl_PointSize = sprite;
      if (own.a == 0.0 || cell.z > most || lit == 0.0) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    }`;
  const FRAGMENT = `
    precision highp float;
    flat in vec3 color, toward, open; flat in float sprite, lit;
    uniform mat3 turn; uniform float pixels;
    out vec4 result;
    void main() {
      float light = lit;
      if (sprite > 6.0) {
        // In the plane of the cube's centre, across the line of sight of the camera.
        float far = -dot(turn[2], -toward);
        vec2 offset = (gl_PointCoord - 0.5) * vec2(1.0, -1.0) * sprite * far / pixels;
        vec3 ray = normalize(turn[0] * offset.x + turn[1] * offset.y - toward);
        vec3 a = (-0.5 - toward) / ray, b = (0.5 - toward) / ray;
        vec3 first = min(a, b), last = max(a, b);
        float near = max(max(first.x, first.y), first.z);
        if (near > min(min(last.x, last.y), last.z)) discard;
        vec3 face = vec3(equal(first, vec3(near)));
        light = dot(face * open, vec3(0.8, 0.68, ray.z > 0.0 ? 0.55 : 1.0));
        if (light == 0.0) discard;      // another voxel's face lies before this one
      } else if (sprite > 3.0 && any(greaterThan(abs(gl_PointCoord - 0.5), vec2(0.33)))) discard;
      result = vec4(color * light, 1.0);
    }`;

  const observer = new IntersectionObserver(entries => {
    if (!entries.some(entry => entry.isIntersecting)) return;
    observer.disconnect();
    open().catch(error => {
      note.textContent = 'The 3-D view cannot be shown by this browser: ' + error.message;
      canvas.style.height = '0';
      start.hidden = true;
    });
  }, {rootMargin: '300px'});
  observer.observe(box);

  async function unpacked() {
    const bytes = Uint8Array.from(atob(map.data), letter => letter.charCodeAt(0));
    if (typeof DecompressionStream === 'undefined') throw new Error('it is too old');
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
    const buffer = await new Response(stream).arrayBuffer(), n = map.shown;
    const cell = new Uint16Array(4 * n), info = new Uint8Array(4 * n);
    for (let k = 0; k < 4; k++) {
      const shorts = new Uint16Array(buffer, 2 * n * k, n);
      const octets = new Uint8Array(buffer, 8 * n + n * k, n);
      for (let i = 0; i < n; i++) { cell[4 * i + k] = shorts[i]; info[4 * i + k] = octets[i]; }
    }
    return {cell, info};
  }

  function texture(colors, width) {
    const height = Math.ceil(colors.length / width), bytes = new Uint8Array(4 * width * height);
    colors.forEach((color, i) => bytes.set([...color, 255], 4 * i));
    const result = new THREE.DataTexture(bytes, width, height);
    result.needsUpdate = true;
    return result;
  }

  function smooth(ramp) {
    return Array.from({length: 256}, (_, i) => {
      const at = i / 255 * (ramp.length - 1), k = Math.min(ramp.length - 2, Math.floor(at));
      return [0, 1, 2].map(c => ramp[k][c] + (ramp[k + 1][c] - ramp[k][c]) * (at - k));
    });
  }

  // Some voxels stand for all where the view is fitted, and strays must not make the map small.
  function some(cell) {
    const result = [];
    for (let i = 0, step = 4 * Math.ceil(cell.length / 60000); i < cell.length; i += step) {
      result.push([cell[i] + 0.5, cell[i + 1] + 0.5, cell[i + 2] + 0.5]);
    }
    return result;
  }

  function quantile(values, share) {
    return values.sort((a, b) => a - b)[Math.floor(share * (values.length - 1))];
  }

  function middleOf(places) {
    return [0, 1, 2].map(k => {
      const values = places.map(place => place[k]);
      return (quantile(values, 0.02) + quantile(values, 0.98)) / 2;
    });
  }

  async function open() {
    const {cell, info} = await unpacked();
    const renderer = new THREE.WebGLRenderer({canvas, antialias: false, alpha: true});
    renderer.outputColorSpace = 'srgb-linear';
    renderer.setPixelRatio(Math.min(devicePixelRatio || 1, 2));
    const places = some(cell), middle = middleOf(places);
    places.forEach(place => middle.forEach((m, k) => { place[k] -= m; }));
    const radius = quantile(places.map(place => Math.hypot(...place)), 0.97) + 2;
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('cell', new THREE.BufferAttribute(cell, 4));
    geometry.setAttribute('info', new THREE.BufferAttribute(info, 4));
    geometry.setDrawRange(0, map.shown);
    const palette = texture(map.classes.map(item => item.color), 256);
    const material = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT,
      uniforms: {
        middle: {value: new THREE.Vector3(...middle)}, eye: {value: new THREE.Vector3()},
        cut: {value: map.heights}, most: {value: 1e9}, everywhere: {value: 0}, pixels: {value: 1}, mode: {value: 0},
        palette: {value: palette}, ramp: {value: texture(smooth(map.ramp), 256)},
        sources: {value: texture(map.sources, map.sources.length)},
        turn: {value: new THREE.Matrix3()},
      },
    });
    const uniforms = material.uniforms, scene = new THREE.Scene();
    const cubes = new THREE.Points(geometry, material);
    cubes.frustumCulled = false;
    scene.add(cubes);
    for (const track of map.track) {
      const line = new THREE.BufferGeometry();
      const corners = Float32Array.from(track, (v, i) => v - middle[i % 3]);
      line.setAttribute('position', new THREE.BufferAttribute(corners, 3));
      const path = new THREE.Line(line, new THREE.LineBasicMaterial({color: 0xffffff}));
      path.frustumCulled = false;
      scene.add(path);
    }

    const camera = new THREE.PerspectiveCamera(45, 1, radius / 500, radius * 30);
    camera.up.set(0, 0, 1);
    const controls = new THREE.OrbitControls(camera, canvas);
    controls.enableDamping = false;
    controls.maxDistance = radius * 12;
    controls.minDistance = radius / 40;
    controls.enabled = !touch;
    controls.enableZoom = false;        // until a click: the wheel scrolls the page
    canvas.style.touchAction = touch ? 'auto' : 'none';
    const engage = () => {
      controls.enabled = controls.enableZoom = true;
      canvas.style.touchAction = 'none';
      start.hidden = true;
    };
    start.onclick = engage;
    if (!touch) canvas.addEventListener('pointerdown', engage);
    document.addEventListener('pointerdown', event => {
      if (box.contains(event.target)) return;
      controls.enableZoom = false;
      controls.enabled = !touch;
      if (touch) { canvas.style.touchAction = 'auto'; start.hidden = false; }
    });

    let waiting = false;
    const draw = () => {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => {
        waiting = false;
        const width = canvas.clientWidth, height = canvas.clientHeight;
        if (!width || !height) return;
        const ratio = renderer.getPixelRatio();
        if (canvas.width !== Math.floor(width * ratio) ||
            canvas.height !== Math.floor(height * ratio)) {
          renderer.setSize(width, height, false);
          camera.aspect = width / height;
          camera.updateProjectionMatrix();
        }
        camera.updateMatrixWorld();
        uniforms.eye.value.copy(camera.position);
        uniforms.turn.value.setFromMatrix4(camera.matrixWorld);
        uniforms.pixels.value =
          renderer.getDrawingBufferSize(new THREE.Vector2()).y / 2 /
          Math.tan(camera.fov * Math.PI / 360);
        renderer.render(scene, camera);
      });
    };
    const look = (x, y, z) => {
      const tan = Math.tan(camera.fov * Math.PI / 360);
      const wide = tan * (canvas.clientWidth || 1) / (canvas.clientHeight || 1);
      controls.target.set(0, 0, 0);
      camera.position.set(x, y, z).normalize();
      controls.update();
      camera.updateMatrixWorld();
      const [right, up, back] = [0, 1, 2].map(
        k => new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, k));
      const seen = places.map(place => {
        const at = new THREE.Vector3(...place);
        return [at.dot(right), at.dot(up), at.dot(back)];
      });
      // The distance from which most is in sight, and the height at which it lies in the middle.
      let shift = 0, away = 0;
      for (let k = 0; k < 4; k++) {
        away = quantile(seen.map(([r, u, b]) =>
          b + Math.max(Math.abs(r) / wide, Math.abs(u - shift) / tan)), 0.99) * 1.06 + 1;
        const heights = seen.filter(([, , b]) => b < 0.9 * away).map(
          ([, u, b]) => (u - shift) / (away - b));
        shift += away * (quantile(heights, 0.005) + quantile(heights, 0.995)) / 2;
      }
      const middle = up.clone().multiplyScalar(shift);
      camera.position.copy(middle).addScaledVector(back, away);
      // Turned about a place in the map, not above or below it.
      controls.target.copy(middle).addScaledVector(back, -middle.z / back.z);
      controls.update();
      draw();
    };
    controls.addEventListener('change', draw);
    new ResizeObserver(draw).observe(canvas);
    canvas.addEventListener('webglcontextrestored', draw);
    document.getElementById('reset').onclick = () => look(-0.55, -1, 0.95);
    document.getElementById('from-above').onclick = () => look(0, -0.001, 1);
    const full = document.getElementById('full');
    full.hidden = !box.requestFullscreen;
    full.onclick = () => document.fullscreenElement ? document.exitFullscreen()
      : box.requestFullscreen().then(engage);

    for (const button of box.querySelectorAll('button[data-mode]')) {
      button.onclick = () => {
        for (const other of box.querySelectorAll('button[data-mode]')) {
          other.setAttribute('aria-pressed', other === button);
        }
        for (const key of document.querySelectorAll('.viewer-key [data-key]')) {
          key.hidden = key.dataset.key !== button.dataset.mode;
        }
        uniforms.mode.value = +button.dataset.mode;
        draw();
      };
    }
    for (const button of document.querySelectorAll('.viewer-key [data-class]')) {
      button.onclick = () => {
        const on = button.getAttribute('aria-pressed') !== 'true';
        button.setAttribute('aria-pressed', on);
        palette.image.data[4 * +button.dataset.class + 3] = on ? 255 : 0;
        palette.needsUpdate = true;
        // What a hidden class covered is to be seen now.
        uniforms.everywhere.value = +!!document.querySelector('[data-class][aria-pressed="false"]');
        draw();
      };
    }
    const slider = document.getElementById('cut'), value = document.getElementById('cut-value');
    slider.oninput = () => {
      const cells = map.span[2], top = Math.ceil(slider.value / 1000 * cells);
      uniforms.most.value = +slider.value === 1000 ? 1e9 : top - 0.5;
      value.textContent = +slider.value === 1000 ? 'all'
        : (map.low[2] + top * map.size).toFixed(map.size < 0.1 ? 2 : 1) + ' m';
      draw();
    };
    slider.oninput();
    look(-0.55, -1, 0.95);
    box.dataset.ready = 'true';
  }
})();
