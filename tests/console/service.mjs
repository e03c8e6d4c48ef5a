// A service with a hall in which things have changed: the demonstration drives it, then it is served.

import { spawn } from "node:child_process";
import fs from "node:fs";
import os from "node:os";
import path from "node:path";

const LAPS = "4";

/** Runs to its end, and returns what it printed. */
function run(program, args) {
  return new Promise((resolve, reject) => {
    const child = spawn(program, args, { stdio: ["ignore", "pipe", "pipe"] });
    let [printed, said] = ["", ""];
    child.stdout.on("data", (part) => { printed += part; });
    child.stderr.on("data", (part) => { said += part; });
    child.on("error", reject);
    child.on("close", (code) => (code === 0 ? resolve(printed) : reject(new Error(program + " " + args[0] + " ended with " + code + ": " + said))));
  });
}

/** The port that the service says it listens on. */
function listening(child) {
  return new Promise((resolve, reject) => {
    let said = "";
    const hear = (part) => {
      said += part;
      const found = /127\.0\.0\.1:(\d+)/.exec(said);
      if (found) resolve(Number(found[1]));
    };
    child.stdout.on("data", hear);
    child.stderr.on("data", hear);
    child.on("error", reject);
    child.on("close", () => reject(new Error("the service ended: " + said)));
  });
}

/**
 * Drives the demonstration, and returns the directory of its data.
 * @param {string} program the path of mapshift
 */
export async function demonstrate(program) {
  const data = fs.mkdtempSync(path.join(os.tmpdir(), "mapshift-console-"));
  await run(program, ["demo", "--exit", "--laps", LAPS, "--listen", "127.0.0.1:0", "--data", data]);
  return data;
}

/**
 * @param {string} program
 * @param {string} data
 */
export async function serve(program, data) {
  const child = spawn(program, ["serve", "--data", data, "--listen", "127.0.0.1:0"], { stdio: ["ignore", "pipe", "pipe"] });
  const port = await listening(child);
  const stop = async () => {
    if (child.exitCode !== null) return;
    const ended = new Promise((resolve) => { child.on("close", resolve); });
    child.kill("SIGTERM");
    await ended;
  };
  return { port, stop };
}

/** Makes a key while no service holds the data, and returns it. */
export async function makeKey(program, data, name, role) {
  const printed = await run(program, ["keys", "create", "--data", data, "--name", name, "--role", role]);
  return /ms_[\w.-]+/.exec(printed)[0];
}
