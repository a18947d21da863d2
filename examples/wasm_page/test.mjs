// Chooses a cloud in the page, in headless Chromium, and looks at the result: node --experimental-websocket test.mjs snake.html cloud.ply [picture.png]
import { spawn } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [page, cloud, picture] = process.argv.slice(2).map(path => resolve(path));
const profile = mkdtempSync(join(tmpdir(), "wasm_page"));
const browser = spawn(process.env.CHROMIUM ?? "chromium", [
  "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0", "--window-size=1200,800",
  `--user-data-dir=${profile}`, pathToFileURL(page).href,
]);

/** The address at which the browser takes commands. */
const address = await new Promise((found, failed) => {
  let text = "";
  browser.stderr.on("data", data => {
    text += data;
    const match = text.match(/DevTools listening on ws:\/\/([^/]+)/);
    if (match) found(match[1]);
  });
  browser.on("exit", () => failed(new Error(text)));
});
try {
  let target;
  while (!target) target = (await (await fetch(`http://${address}/json`)).json()).find(one => one.type === "page");
  const socket = new WebSocket(target.webSocketDebuggerUrl);
  await new Promise(opened => socket.addEventListener("open", opened));
  let number = 0;
  const call = (method, params = {}) => new Promise((done, failed) => {
    const id = ++number;
    const listen = ({ data }) => {
      const answer = JSON.parse(data);
      if (answer.id !== id) return;
      socket.removeEventListener("message", listen);
      answer.error ? failed(new Error(answer.error.message)) : done(answer.result);
    };
    socket.addEventListener("message", listen);
    socket.send(JSON.stringify({ id, method, params }));
  });
  const value = async expression => (await call("Runtime.evaluate", { expression, awaitPromise: true })).result.value;

  const isLoaded = "document.readyState === 'complete' && document.getElementById('file') !== null";
  while (!await value(isLoaded)) await new Promise(done => setTimeout(done, 100));
  const { root } = await call("DOM.getDocument");
  const { nodeId } = await call("DOM.querySelector", { nodeId: root.nodeId, selector: "#file" });
  await call("DOM.setFileInputFiles", { nodeId, files: [cloud] });
  let status;
  do {
    await new Promise(done => setTimeout(done, 200));
    status = await value("document.getElementById('status').textContent");
  } while (!/: (?!detecting)/.test(status));
  console.log(status);
  if (!status.includes("done in")) throw new Error(status);
  const html = await value("document.getElementById('view').srcdoc");
  if (!html.startsWith("<!doctype html>") || !html.includes('"keypoints":[{')) throw new Error("the page has no keypoints");

  const broken = await value("detect('cloud.ply', new Uint8Array([1, 2, 3])).then(() => 'no error', error => error.message)");
  console.log("a broken file:", broken);
  if (broken === "no error") throw new Error("a broken file gives a page");
  if (picture) {
    await new Promise(done => setTimeout(done, 2000));
    const { data } = await call("Page.captureScreenshot");
    writeFileSync(picture, Buffer.from(data, "base64"));
  }
} finally {
  browser.on("exit", () => rmSync(profile, { recursive: true, force: true, maxRetries: 5 }));
  browser.kill();
}
