// Counting what holds and what does not.

let passed = 0;
const failures = [];

/** Runs a check that throws if something does not hold. */
export async function check(name, body) {
  try {
    await body();
    passed += 1;
    console.log("ok      " + name);
  } catch (error) {
    failures.push(name);
    console.log("FAILED  " + name + "\n        " + String(error.stack ?? error).split("\n").slice(0, 6).join("\n        "));
  }
}

export function equal(found, expected, what = "") {
  if (found !== expected) throw new Error(what + " is " + JSON.stringify(found) + ", not " + JSON.stringify(expected));
}

export function holds(condition, what) {
  if (!condition) throw new Error(what);
}

/** Waits until something holds. */
export async function until(body, what) {
  for (let turn = 0; turn < 150; turn += 1) {
    if (await body()) return;
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
  throw new Error("waited in vain: " + what);
}

/** Prints the sum, and returns the exit status. */
export function sum() {
  console.log(passed + " passed, " + failures.length + " failed");
  return failures.length === 0 ? 0 : 1;
}
