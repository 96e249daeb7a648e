'use strict';
(() => {
  const $ = (query, root = document) => root.querySelector(query);
  const $$ = (query, root = document) => [...root.querySelectorAll(query)];
  const data = id => JSON.parse($('#' + id).textContent);
  const press = (button, on) => button.setAttribute('aria-pressed', on);

  // Theme: as the system says, or light, or dark. A page opened as a file may not have storage.
  const themes = ['auto', 'light', 'dark'];
  const remembered = {
    get() { try { return localStorage.getItem('persem-theme'); } catch { return null; } },
    set(value) { try { localStorage.setItem('persem-theme', value); } catch { /* no storage */ } },
  };
  const themeButton = $('#theme');
  const setTheme = name => {
    if (name === 'auto') delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = name;
    themeButton.textContent = 'theme: ' + name;
    themeButton.dataset.now = name;
  };
  setTheme(themes.includes(remembered.get()) ? remembered.get() : 'auto');
  themeButton.hidden = false;
  themeButton.onclick = () => {
    const next = themes[(themes.indexOf(themeButton.dataset.now) + 1) % themes.length];
    remembered.set(next);
    setTheme(next);
  };

  strip();
  map();
  chart();

  function strip() {
    const frames = $$('.frame'), slider = $('#frame-slider');
    if (!frames.length) return;
    const show = i => {
      slider.value = Math.min(frames.length - 1, Math.max(0, i));
      frames.forEach((frame, k) => { frame.hidden = k !== +slider.value; });
      unmark();
    };
    slider.oninput = () => show(+slider.value);
    $('#before').onclick = () => show(+slider.value - 1);
    $('#after').onclick = () => show(+slider.value + 1);
    const larger = $('#larger');
    larger.onclick = () => {
      const on = larger.getAttribute('aria-pressed') !== 'true';
      press(larger, on);
      $$('.panels').forEach(panels => panels.classList.toggle('large', on));
    };
    const verdict = $('#verdict');
    if (verdict) {
      verdict.onclick = () => {
        const on = verdict.getAttribute('aria-pressed') !== 'true';
        press(verdict, on);
        $$('#frames .second').forEach(item => { item.hidden = !on; });
        $$('#frames .first').forEach(item => { item.hidden = on; });
        $$('#frames .changed figcaption > :not(.second)').forEach(item => { item.hidden = on; });
      };
    }
    // The label under the pointer: the picture's own colour, looked up in the legend.
    const names = new Map(data('strip-classes').map(c => [c.color.join(), c.name]));
    const pixels = new Map();
    const labelAt = (img, x, y) => {
      if (!pixels.has(img)) {
        const canvas = document.createElement('canvas');
        canvas.width = img.naturalWidth;
        canvas.height = img.naturalHeight;
        const context = canvas.getContext('2d', {willReadFrequently: true});
        context.drawImage(img, 0, 0);
        pixels.set(img, context);
      }
      const place = (v, n) => Math.min(n - 1, Math.max(0, Math.floor(v * n)));
      const at = pixels.get(img).getImageData(
        place(x, img.naturalWidth), place(y, img.naturalHeight), 1, 1).data;
      return names.get([...at.slice(0, 3)].join()) || '';
    };
    const unmark = () => $$('.cross, .tag').forEach(item => item.remove());
    const mark = event => {
      const box = event.currentTarget.getBoundingClientRect();
      const x = (event.clientX - box.left) / box.width, y = (event.clientY - box.top) / box.height;
      unmark();
      for (const picture of $$('.picture', event.currentTarget.closest('.panels'))) {
        const cross = picture.appendChild(document.createElement('i'));
        cross.className = 'cross';
        cross.style.left = 100 * x + '%';
        cross.style.top = 100 * y + '%';
        const img = $('img.labels', picture), text = img && img.complete && labelAt(img, x, y);
        if (text) {
          const tag = picture.appendChild(document.createElement('span'));
          tag.className = 'tag';
          tag.textContent = text;
        }
      }
    };
    for (const picture of $$('.picture')) {
      picture.addEventListener('pointermove', mark);
      picture.addEventListener('pointerdown', mark);
      picture.addEventListener('pointerleave', event => {
        if (event.pointerType === 'mouse') unmark();
      });
    }
  }

  function map() {
    const root = $('#map');
    for (const button of $$('button[data-layer]', root)) {
      button.onclick = () => {
        const layer = button.dataset.layer;
        $$('button[data-layer]', root).forEach(b => press(b, b === button));
        $$('img[data-layer], div[data-layer]', root).forEach(item => {
          item.hidden = item.dataset.layer !== layer;
        });
      };
    }
    const path = $('#path');
    if (path) {
      path.onclick = () => {
        const on = path.getAttribute('aria-pressed') !== 'true';
        press(path, on);
        $('svg', root).style.display = on ? '' : 'none';
      };
    }
  }

  function chart() {
    const box = $('.chart'), source = $('#flicker-data');
    if (!box || !source) return;
    const flicker = JSON.parse(source.textContent), t = flicker.t, cursor = $('.cursor', box);
    const point = event => {
      const area = box.getBoundingClientRect();
      const at = t[0] + (event.clientX - area.left) / area.width * (t[t.length - 1] - t[0]);
      let near = 0;
      t.forEach((value, i) => { if (Math.abs(value - at) < Math.abs(t[near] - at)) near = i; });
      cursor.hidden = false;
      cursor.style.left = 100 * (t[near] - t[0]) / (t[t.length - 1] - t[0]) + '%';
      $('#chart-time').textContent = 'at ' + t[near].toFixed(1) + ' s';
      $$('[data-line]').forEach(output => {
        const value = flicker.lines[output.dataset.line][near];
        output.textContent = value === null ? '–' : value.toFixed(1) + ' %';
      });
    };
    const leave = () => {
      cursor.hidden = true;
      $$('[data-line], #chart-time').forEach(output => { output.textContent = ''; });
    };
    box.addEventListener('pointermove', point);
    box.addEventListener('pointerdown', point);
    box.addEventListener('pointerleave', leave);
  }
})();
