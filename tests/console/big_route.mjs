// Makes a route of 1 km that was driven ten times, to see how the console copes with it.
// Usage: node big_route.mjs URL [ROUTE [LAPS]]

const [url = "http://127.0.0.1:8080", route = "big", lapsText = "10"] = process.argv.slice(2);
const LAPS = Number(lapsText);
const SIDE_M = 250;
const STEP_M = 1;
const BEAMS = 181;
const RANGE_MAX_M = 25;
const SCANS_A_BATCH = 100;
const BUCKET_M = 30;

/** A seeded generator of numbers in [0, 1): mulberry32. */
function random(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

/** Walls of houses on both sides of a square of streets: [x0, y0, x1, y1], metres. */
function walls() {
  const draw = random(1);
  const made = [];
  const corners = [[0, 0], [SIDE_M, 0], [SIDE_M, SIDE_M], [0, SIDE_M]];
  corners.forEach(([x, y], k) => {
    const [nextX, nextY] = corners[(k + 1) % 4];
    const along = [(nextX - x) / SIDE_M, (nextY - y) / SIDE_M];
    for (const side of [1, -1]) {
      let from = side === 1 ? 6 : -6;
      const end = SIDE_M - from;
      while (from < end) {
        const to = Math.min(end, from + 6 + 9 * draw());
        const away = side * (5 + 2.5 * draw());
        const at = (s, a) => [x + along[0] * s - along[1] * a, y + along[1] * s + along[0] * a];
        const front = [at(from, away), at(to, away)];
        const back = [at(from, away + side * 4), at(to, away + side * 4)];
        made.push([...front[0], ...front[1]], [...front[0], ...back[0]], [...front[1], ...back[1]]);
        const pole = at(from + 2 * draw(), side * 3.5);
        made.push([pole[0] - 0.15, pole[1], pole[0] + 0.15, pole[1]], [pole[0], pole[1] - 0.15, pole[0], pole[1] + 0.15]);
        from = to + 1.5 * draw();
      }
    }
  });
  return made;
}

function bucketed(segments) {
  const buckets = new Map();
  for (const segment of segments) {
    const [x0, y0, x1, y1] = segment;
    const span = (a, b) => [Math.floor((Math.min(a, b) - RANGE_MAX_M) / BUCKET_M), Math.floor((Math.max(a, b) + RANGE_MAX_M) / BUCKET_M)];
    const [left, right] = span(x0, x1);
    const [low, high] = span(y0, y1);
    for (let i = left; i <= right; i++) {
      for (let j = low; j <= high; j++) {
        const key = i + " " + j;
        if (!buckets.has(key)) buckets.set(key, []);
        buckets.get(key).push(segment);
      }
    }
  }
  return ({ x, y }) => buckets.get(Math.floor(x / BUCKET_M) + " " + Math.floor(y / BUCKET_M)) ?? [];
}

/** Where a beam ends, metres; null without a return. */
function range(near, { x, y }, angle) {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  let best = RANGE_MAX_M;
  for (const [x0, y0, x1, y1] of near) {
    const [dx, dy] = [x1 - x0, y1 - y0];
    const det = dx * sin - dy * cos;
    if (Math.abs(det) < 1e-12) continue;
    const [ox, oy] = [x0 - x, y0 - y];
    const t = (dx * oy - dy * ox) / det;
    const u = (cos * oy - sin * ox) / det;
    if (t > 0.05 && t < best && u >= 0 && u <= 1) best = t;
  }
  return best < RANGE_MAX_M ? best : null;
}

/** The pose at a way along the square, driven counter-clockwise with rounded corners. */
function poseAt(way) {
  const round = 8;
  const s = ((way % (4 * SIDE_M)) + 4 * SIDE_M) % (4 * SIDE_M);
  const side = Math.floor(s / SIDE_M);
  const along = s - side * SIDE_M;
  const corner = [[0, 0], [SIDE_M, 0], [SIDE_M, SIDE_M], [0, SIDE_M]][side];
  const heading = (side * Math.PI) / 2;
  const turn = along > SIDE_M - round ? ((along - SIDE_M + round) / round) * (Math.PI / 4) : along < round ? (along / round - 1) * (Math.PI / 4) : 0;
  return { x: corner[0] + along * Math.cos(heading), y: corner[1] + along * Math.sin(heading), theta: heading + turn };
}

async function put(path, body) {
  for (;;) {
    const response = await fetch(url + path, { method: "PUT", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
    if (response.ok) return;
    if (![408, 429, 503].includes(response.status)) throw new Error(path + ": " + response.status + " " + (await response.text()));
    await new Promise((resolve) => setTimeout(resolve, 1000));
  }
}

async function drive(lap, near) {
  const noise = random(100 + lap);
  const gauss = () => Math.sqrt(-2 * Math.log(1 - noise())) * Math.cos(2 * Math.PI * noise());
  const lidar = { angle_min: -Math.PI / 2, angle_increment: Math.PI / (BEAMS - 1), range_min: 0.05, range_max: RANGE_MAX_M, range_sigma: 0.01 };
  const count = Math.round((4 * SIDE_M) / STEP_M) + 20;
  const begun = Date.UTC(2026, 10, 1) + lap * 3600000;
  let scans = [];
  let sequence = 0;
  for (let k = 0; k < count; k++) {
    const pose = poseAt(20 + k * STEP_M);
    const around = near(pose);
    const ranges = Array.from({ length: BEAMS }, (_, beam) => {
      const hit = range(around, pose, pose.theta + lidar.angle_min + beam * lidar.angle_increment);
      return hit === null ? null : Number((hit + 0.01 * gauss()).toFixed(4));
    });
    scans.push({ stamp: new Date(begun + k * 1000).toISOString(), odometry: pose, ranges });
    if (scans.length === SCANS_A_BATCH || k === count - 1) {
      const start = sequence === 0 ? { initial_pose: { ...poseAt(20), sigma_xy: 0.1, sigma_theta: 0.02 } } : {};
      await put("/v1/routes/" + route + "/batches/lap-" + lap + "-" + sequence, { vehicle_id: "car-" + (lap % 3), trip_id: "lap-" + lap, sequence, lidar, ...start, scans });
      scans = [];
      sequence += 1;
    }
  }
}

await put("/v1/routes/" + route, {});
const near = bucketed(walls());
for (let lap = 0; lap < LAPS; lap++) await drive(lap, near);
for (;;) {
  const state = await (await fetch(url + "/v1/routes/" + route)).json();
  console.log(JSON.stringify({ ...state.counts, pending: state.pending_batches }));
  if (state.pending_batches === 0) break;
  await new Promise((resolve) => setTimeout(resolve, 5000));
}
