// The page's Python: one worker, which loads Pyodide and pfedu once and then draws what it is asked to.
//   in:  {start: {pyodide, pfedu}}   then  {id, name, layout, positions}
//   out: {progress: {stage, bytes}}, {ready: true}, {failed: text}, {id, pixels, width, height, words, ms}, {id, error}
let render;

function countBytes() {
  const plain = self.fetch.bind(self);
  let bytes = 0, told = 0;
  self.fetch = async (...args) => {
    const response = await plain(...args);
    if (!response.ok || !response.body) return response;
    const counter = new TransformStream({
      transform(chunk, out) {
        bytes += chunk.byteLength;
        if (bytes - told > 2e5) { told = bytes; postMessage({ progress: { bytes } }); }
        out.enqueue(chunk);
      },
    });
    return new Response(response.body.pipeThrough(counter), { headers: response.headers, status: response.status });
  };
}

async function start({ pyodide, pfedu }) {
  const stage = text => postMessage({ progress: { stage: text } });
  countBytes();
  stage('Loading Python');
  const archive = fetch(pfedu).then(response => response.arrayBuffer());
  importScripts(pyodide + 'pyodide.js');
  const python = await loadPyodide({ indexURL: pyodide });
  stage('Loading numpy and matplotlib');
  await python.loadPackage(['numpy', 'matplotlib'], { messageCallback: () => {}, errorCallback: text => console.warn(text) });
  stage('Starting the explorer');
  python.unpackArchive(await archive, 'zip');
  render = python.pyimport('pfedu.live.browser').render;
}

function draw({ id, name, layout, positions }) {
  const began = performance.now();
  const answer = render(name, layout, JSON.stringify(positions));
  const [array, words] = answer;
  const buffer = array.getBuffer('u8clamped');
  const [height, width] = buffer.shape;
  const pixels = buffer.data.slice();
  buffer.release(); array.destroy(); answer.destroy();
  postMessage({ id, pixels: pixels.buffer, width, height, words: JSON.parse(words), ms: performance.now() - began }, [pixels.buffer]);
}

const lastLine = error => String(error.message || error).trim().split('\n').pop();

onmessage = async ({ data }) => {
  if (data.start) {
    try { await start(data.start); postMessage({ ready: true }); }
    catch (error) { postMessage({ failed: lastLine(error) }); }
  } else {
    try { draw(data); } catch (error) { postMessage({ id: data.id, error: lastLine(error) }); }
  }
};
