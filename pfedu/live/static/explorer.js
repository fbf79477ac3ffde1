// Explorers in the page. The picture, its sentence and its controls are in the HTML already; this script makes the
// controls answer: at first with pictures drawn when the book was built, then with Python, which one worker for the
// whole page loads at the first touch.
(() => {
  const script = document.currentScript;
  const here = name => new URL(name, script.src).href;
  const narrow = matchMedia('(max-width: 600px)');

  // ---- Python: one worker for the page ----------------------------------------------------------------------------
  const python = {
    state: 'off', // off, loading, ready, failed
    line: '', bytes: 0, stage: '', worker: null, asked: 0, waiting: new Map(), listeners: [],

    start() {
      if (this.state !== 'off') return;
      this.tell('loading', 'Loading Python');
      try {
        this.worker = new Worker(here('worker.js' + script.dataset.version));
      } catch (error) {
        return this.fail('a page opened as a file may not start it; open the book through a web server');
      }
      this.worker.onerror = event => { event.preventDefault(); this.fail(event.message || 'its worker could not be loaded'); };
      this.worker.onmessage = ({ data }) => this.hear(data);
      this.worker.postMessage({ start: { pyodide: here(script.dataset.pyodide), pfedu: here('pfedu.zip' + script.dataset.version) } });
    },

    hear(data) {
      if (data.progress) {
        this.stage = data.progress.stage || this.stage;
        this.bytes = data.progress.bytes || this.bytes;
        this.tell('loading', `${this.stage}${this.bytes ? ` (${(this.bytes / 1e6).toFixed(1)} MB so far)` : ''} …`);
      } else if (data.ready) {
        this.tell('ready', 'Live: Python runs in this page.');
      } else if (data.failed) {
        this.fail(data.failed);
      } else {
        const { answer, refuse } = this.waiting.get(data.id);
        this.waiting.delete(data.id);
        data.error ? refuse(new Error(data.error)) : answer(data);
      }
    },

    fail(why) {
      this.worker?.terminate();
      for (const { refuse } of this.waiting.values()) refuse(new Error(why));
      this.waiting.clear();
      this.why = why;
      this.tell('failed', 'Python could not be loaded (no connection?). The pictures drawn beforehand still answer, one control at a time.');
    },

    tell(state, line) { this.state = state; this.line = line; this.listeners.forEach(listen => listen()); },

    draw(request) {
      const id = ++this.asked;
      return new Promise((answer, refuse) => {
        this.waiting.set(id, { answer, refuse });
        this.worker.postMessage({ id, ...request });
      });
    },
  };

  // ---- One explorer -----------------------------------------------------------------------------------------------
  class Explorer {
    constructor(element) {
      this.element = element;
      const find = name => element.querySelector('.pfedu-' + name);
      Object.assign(this, { image: find('poster'), canvas: find('canvas'), sentence: find('sentence'), spoken: find('spoken'),
                            status: find('status'), form: find('controls'), table: find('numbers tbody'), puzzles: find('puzzles') });
      this.data = JSON.parse(element.querySelector('script').textContent);
      this.folder = new URL('.', element.querySelector('.pfedu-poster').src).href;
      this.inputs = [...this.form.querySelectorAll('[data-control]')];
      this.busy = this.changed = false;
      this.cache = new Map();
      element.querySelectorAll('source').forEach(source => source.remove());
      for (const input of this.inputs) {
        input.addEventListener(input.type === 'button' ? 'click' : 'input', () => this.move(input));
        for (const kind of ['pointerenter', 'focus']) input.addEventListener(kind, () => this.fetchFrames(input.dataset.control));
      }
      this.form.addEventListener('submit', event => event.preventDefault());
      find('reset').addEventListener('click', () => { this.pause(); this.reset(); });
      element.querySelectorAll('.pfedu-play').forEach(button => button.addEventListener('click', () => this.playOrPause(button)));
      for (const kind of ['pointerenter', 'pointerdown', 'focusin']) this.form.addEventListener(kind, () => python.start());
      python.listeners.push(() => this.pythonChanged());
      narrow.addEventListener('change', () => this.answer());
      this.form.hidden = false;
      if (this.puzzles) this.puzzles.hidden = false;
      this.inputs.forEach(input => this.label(input));
      this.showFrame();
    }

    get layout() { return narrow.matches ? 'narrow' : 'wide'; }
    position(input) { return Number(input.dataset.position ?? input.value); }
    get positions() { return Object.fromEntries(this.inputs.map(input => [input.dataset.control, this.position(input)])); }

    label(input) {
      const text = this.data.texts[input.dataset.control][this.position(input)];
      const output = input.closest('.pfedu-control').querySelector('output');
      if (output) output.textContent = text;
      if (input.type === 'range') input.setAttribute('aria-valuetext', text);
    }

    move(input) {
      if (this.playing && this.playing.input !== input) this.pause();
      if (input.type === 'button') { // round again, before Python is up at the last seed that was drawn
        const name = input.dataset.control, all = this.data.texts[name].length;
        const count = python.state === 'ready' ? all : Math.max(...this.drawn(name)) + 1;
        input.dataset.position = (this.position(input) + 1) % count;
      }
      this.label(input);
      python.start();
      this.answer();
    }

    reset() {
      for (const input of this.inputs) {
        if (input.type === 'button') input.dataset.position = this.data.start[input.dataset.control];
        else input.value = this.data.start[input.dataset.control];
        this.label(input);
      }
      this.answer();
    }

    answer() { return python.state === 'ready' ? this.drawLive() : this.showFrame(); }

    // -- time runs: through every position with Python, through those drawn beforehand without; the next one comes when
    //    the last is drawn, and not before a pause in which it can be seen
    playOrPause(button) {
      if (this.playing) return this.pause();
      const input = button.closest('.pfedu-control').querySelector('input');
      if (this.position(input) === Number(input.max)) input.value = 0;
      this.playing = { button, input };
      this.face(button, true);
      python.start();
      this.fetchFrames(input.dataset.control);
      this.play(this.playing);
    }

    async play(turn) {
      const { input } = turn;
      while (this.playing === turn) {
        this.label(input);
        await Promise.all([this.answer(), new Promise(seen => setTimeout(seen, python.state === 'ready' ? 150 : 450))]);
        const onward = python.state === 'ready' ? this.position(input) + 1
          : Math.min(...this.drawn(input.dataset.control).filter(position => position > this.position(input)));
        if (this.playing !== turn) break;
        if (onward > Number(input.max)) this.pause();
        else input.value = onward;
      }
    }

    pause() {
      if (this.playing) this.face(this.playing.button, false);
      this.playing = null;
    }

    face(button, pressed) {
      button.textContent = pressed ? '⏸ Pause' : '▶ Play';
      button.setAttribute('aria-pressed', pressed);
    }

    pythonChanged() {
      if (python.state === 'ready') this.drawLive();
      else if (python.state === 'failed') this.showFrame();
      this.say();
    }

    say(error) {
      if (error) this.status.textContent = `Not redrawn: ${error}. The last picture stays.`;
      else this.status.textContent = [this.note, python.line].filter(Boolean).join(' ');
      this.status.title = python.why || '';
      this.element.dataset.python = python.state;
    }

    // -- pictures drawn beforehand: each control moved alone, and a few combinations
    fileOf(key) { return `${this.folder}${this.layout}-${key}.png`; }

    keyOf(inputs) { return inputs.map(i => `${i.dataset.control}-${this.position(i)}`).join('-') || 'start'; }

    drawn(name) { // positions of one control, moved alone, of which there is a picture
      const own = Object.keys(this.data.frames).filter(key => new RegExp(`^${name}-\\d+$`).test(key));
      return [this.data.start[name], ...own.map(key => Number(key.split('-')[1]))];
    }

    fetchFrames(name) {
      if (python.state === 'ready') return;
      for (const position of this.drawn(name)) {
        const file = this.fileOf(position === this.data.start[name] ? 'start' : `${name}-${position}`);
        if (!this.cache.has(file)) this.cache.set(file, Object.assign(new Image(), { src: file }));
      }
    }

    showFrame() {
      const { start, frames, texts } = this.data;
      const moved = this.inputs.filter(input => this.position(input) !== start[input.dataset.control]);
      let key = this.keyOf(moved);
      this.note = '';
      if (!frames[key] && moved.length === 1) {
        const name = moved[0].dataset.control, wanted = this.position(moved[0]);
        const nearest = this.drawn(name).reduce((a, b) => (Math.abs(b - wanted) < Math.abs(a - wanted) ? b : a));
        key = nearest === start[name] ? 'start' : `${name}-${nearest}`;
        this.note = `Shown: ${texts[name][nearest]}, the nearest position drawn beforehand.`;
      }
      this.element.classList.toggle('pfedu-stale', !frames[key]);
      if (!frames[key]) {
        this.note = python.state === 'failed'
          ? 'Several controls have been moved, and there is no Python to draw that: go back to the start, or undo one of them.'
          : 'Several controls have been moved: the picture follows as soon as Python is up.';
        return this.say();
      }
      const [sentence, table, numbers, solved] = frames[key];
      this.show('frame', sentence, this.data.tables[table], numbers, solved);
      this.image.src = this.fileOf(key);
      this.image.alt = sentence;
      this.image.hidden = false;
      this.canvas.hidden = true;
      this.say();
    }

    // -- pictures drawn by Python: at most one under way, the newest position next
    async drawLive() {
      this.changed = true;
      if (this.busy) return;
      this.busy = true;
      while (this.changed) {
        this.changed = false;
        const layout = this.layout;
        try {
          const result = await python.draw({ name: this.data.name, layout, positions: this.positions });
          this.paint(result);
          this.note = '';
          this.say();
        } catch (error) {
          this.say(error.message);
          if (python.state === 'failed') break;
        }
      }
      this.busy = false;
    }

    paint({ pixels, width, height, words, ms }) {
      if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
      this.canvas.getContext('2d').putImageData(new ImageData(new Uint8ClampedArray(pixels), width, height), 0, 0);
      this.canvas.setAttribute('aria-label', words.sentence);
      this.canvas.hidden = false;
      this.image.hidden = true;
      this.element.classList.remove('pfedu-stale');
      this.element.shown = words;
      this.show('live', words.sentence, Object.keys(words.numbers), Object.values(words.numbers), words.solved);
      this.element.dataset.ms = ms.toFixed(1);
    }

    show(state, sentence, labels, numbers, solved) {
      this.sentence.textContent = sentence;
      this.table.replaceChildren(...labels.map((label, i) => {
        const row = document.createElement('tr');
        const head = Object.assign(document.createElement('th'), { scope: 'row', textContent: label });
        row.append(head, Object.assign(document.createElement('td'), { textContent: Number(numbers[i].toPrecision(6)) }));
        return row;
      }));
      this.puzzles?.querySelectorAll('li').forEach((item, i) => {
        if (!solved[i] || item.dataset.solved) return;
        item.dataset.solved = true; // and stays so, wherever the controls go next
        item.querySelector('.pfedu-verdict').textContent = '✓ Solved:';
        this.news = ' Puzzle solved.';
      });
      this.element.dataset.state = state;
      this.element.dataset.redraws = Number(this.element.dataset.redraws || 0) + 1;
      clearTimeout(this.timer); // read aloud when the hand rests, not at every step of a slider
      this.timer = setTimeout(() => {
        if (this.element.dataset.redraws > 1) this.spoken.textContent = sentence + (this.news || '');
        this.news = '';
      }, 700);
    }
  }

  document.querySelectorAll('.pfedu-explorer').forEach(element => new Explorer(element));
})();
