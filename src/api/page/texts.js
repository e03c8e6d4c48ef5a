// Every text of the console, but the words of enumerations, which are in /words.js.

/** @typedef {Record<string, string>} Words */

/** @param {number} count @param {string} one @param {string} many */
const plural = (count, one, many) => count + " " + (count === 1 ? one : many);

export const TEXTS = {
  // The whole page
  places: /** @type {Words} */ ({ inbox: "Alerts", route: "Routes", report: "Report" }), placesLabel: "Views", api: "API",
  connecting: "Connecting …", live: "Live", broken: "Disconnected",
  lost: "The service does not answer. What you see may be out of date, and decisions are locked; trying again …",
  unreachable: "The service does not answer",
  open: "No keys yet: open to everybody on this machine", by: "Decide as",
  signIn: "Sign in", signOut: "Sign out", key: "Your key", signInHint: "Paste the key that an administrator gave you. It is exchanged for a session and not stored here.",
  role: (/** @type {string} */ name, /** @type {string} */ role) => name + " · " + role,
  nothing: "Nothing here yet.", cancel: "Cancel", close: "Close", undo: "Undo", note: "Note (optional)", noteShort: "Note", failed: "It did not succeed.",
  units: ["d", "h", "min"], justNow: "just now", ago: (/** @type {number} */ amount, /** @type {string} */ unit) => amount + " " + unit + " ago",

  // The list of alerts
  inbox: "Alerts", search: "Search by place, id, vehicle or note", status: "Status", route: "Route", kind: "Kind", when: "Last seen",
  allRoutes: "all routes", allKinds: "all kinds", moreFilters: "More filters", confidence: "at least 90 % sure",
  views: { pending: "To decide", muted: "Muted for now", all: "All" },
  hours: /** @type {[string, string][]} */ ([["0", "at any time"], ["1", "in the last hour"], ["8", "in the last 8 hours"], ["24", "in the last day"], ["168", "in the last week"]]),
  count: (/** @type {number} */ shown, /** @type {number} */ all) => (shown === all ? plural(all, "alert", "alerts") : shown + " of " + plural(all, "alert", "alerts")),
  passes: (/** @type {number} */ count) => plural(count, "pass", "passes"),
  noAlerts: "Nothing to decide: what the vehicles observe agrees with the map.", noMatch: "No alert matches these filters.",
  onlyFirst: (/** @type {number} */ count) => "The first " + count + " are shown: narrow the list by the filters.",
  chosen: (/** @type {number} */ count) => count + " chosen", choose: (/** @type {string} */ title) => "Choose: " + title, chooseAll: "Choose all", clear: "Clear",
  muted: "muted", assignedTo: (/** @type {string} */ name) => "with " + name,
  blocking: /** @type {Words} */ ({ blocking: "On the vehicles' way", near: "Near the vehicles' way", clear: "Clear of the vehicles' way" }),

  // One alert
  panel: "Alert", noneChosen: "Choose an alert to see what changed.", back: "‹ All alerts", unknownAlert: "There is no such alert.",
  evidence: "What was observed", shows: /** @type {Words} */ ({ before: "Before", since: "Since", both: "Both" }), blink: "Blink", fade: "Fade from before to since",
  evidenceAlt: (/** @type {string} */ show) => "Observations at the place: " + show, scans: "Two scans that disagree", noEvidence: "There is no picture of it.", reading: "Reading the observations …",
  evidenceLegend: /** @type {Words} */ ({ before: "hit before", since: "hit since", both: "hit before and since", eye: "where the lidar was" }),
  passesTitle: "Passes by the place", passHint: "Choose a pass to see its scan on the map.", noScan: "No scan of this pass is kept.",
  outcomes: /** @type {Words} */ ({ old_state: "saw the old state", new_state: "saw the new state", could_not_see: "could not see it" }),
  passCounts: (/** @type {import("./types").PassCounts} */ counts) => counts.saw_free + " saw it free, " + counts.saw_occupied + " occupied, " + counts.could_not_see + " could not see it",
  details: "Details", history: "History", onlyMaintainers: "Your role may read; deciding needs the role maintainer.",
  comments: "Assignment and comments", comment: "Comment", postComment: "Comment", takeIt: "Take it", giveBack: "Give back", unassigned: "Nobody takes care of it yet.", somebody: "somebody here",
  fields: {
    where: "Where", size: "Size", since: "Since", last: "Last seen", vehicles: "Vehicles", passes: "Passes since", before: "Passes before", sure: "Confidence", version: "Contradicts map", other: "Other side", shift: "Fits when moved by", bands: "Height", muted: "Muted until",
    deltaF: "ΔF of its strongest closure", threshold: "The paper's threshold", p: "Probability without a change", edges: "Loop closures", nodes: "Nodes", id: "Id", views: "Scans", revision: "Revision",
  },

  // Decisions
  acceptTitle: "Take this change into the map?", acceptBody: "The part of the graph around it is solved again. You can undo this.",
  acceptSeveralTitle: (/** @type {number} */ count) => "Take " + plural(count, "change", "changes") + " into the map?", acceptSeveralBody: "Those on one route make one new version of its map. You can undo each of them.",
  preview: {
    working: "Working out what it would change …", version: "New version", cells: "Map", edges: "Loop closures retired", nodes: "Keyframes handed over", moved: "Poses move by", precision: "Precision", approximate: (/** @type {number} */ nodes) => "approximate: " + plural(nodes, "archived keyframe is", "archived keyframes are") + " read first",
    cellCounts: (/** @type {number} */ occupied, /** @type {number} */ free, /** @type {number} */ unknown, /** @type {number} */ observed) => plural(occupied, "cell becomes", "cells become") + " occupied, " + free + " free, " + unknown + " unknown, " + observed + " newly observed",
    atMost: (/** @type {number} */ metres) => (metres < 0.0005 ? "nothing" : "at most " + (metres * 100).toFixed(1) + " cm"),
  },
  dismissTitle: "Keep the map as it is?", dismissBody: "The same thing at the same place is not raised again while it lasts.", reason: "Reason",
  mute: "Also mute this place for this kind of change",
  muteHours: /** @type {[string, string][]} */ ([["0", "no"], ["8", "for 8 hours"], ["24", "for a day"], ["168", "for a week"]]),
  mutedFor: (/** @type {number} */ hours) => "The place is muted for " + plural(hours, "hour", "hours"),
  working: "The map is being solved again …",
  done: /** @type {Words} */ ({ acknowledge: "Acknowledged", accept: "Accepted: the map shows it now", dismiss: "Dismissed: the map stays as it is", reopen: "Open again", undo: "Undone" }),
  several: (/** @type {number} */ done, /** @type {number} */ failed) => done + " decided" + (failed ? ", " + failed + " not: they have changed or do not allow it" : ""),

  // The map
  tabs: /** @type {Words} */ ({ map: "Map", vehicles: "Vehicles", batches: "Batches", residuals: "Residuals", versions: "Versions", settings: "Settings", audit: "Audit" }),
  noRoute: "No route yet. A vehicle's first upload needs one: PUT /v1/routes/{route}.",
  routeSummary: (/** @type {import("./types").Route} */ route) => "map version " + route.map_version + (route.pending_batches ? ", " + plural(route.pending_batches, "batch waits", "batches wait") : ""),
  picture: "Map shown", pictures: /** @type {Words} */ ({ accepted: "Accepted map", observed: "With pending changes" }), versionNumber: (/** @type {number} */ version, /** @type {string} */ state) => "Version " + version + (state ? ", " + state : ""),
  versionsCompared: (/** @type {number} */ version, /** @type {number} */ before) => "Version " + version + " against " + before, differenceHint: "Orange was added, blue was removed",
  layersTitle: "Layers", layers: /** @type {Words} */ ({ trajectories: "Trajectories by vehicle", residuals: "Worst closures by residual", references: "Reference keyframes", vehicles: "Last poses" }),
  fit: "Fit", zoomIn: "Zoom in", zoomOut: "Zoom out", noMap: "No map yet: nothing has been merged.", noCanvas: "This browser cannot draw the map.",
  mapLabel: (/** @type {string} */ route) => "Map of the route " + route + " with the places of its alerts, which the list has too",

  // The other tabs
  vehicles: {
    head: ["Vehicle", "State", "Trips", "Scans", "Last seen", "What is known of it", "Decide"],
    states: /** @type {Words} */ ({ trusted: "trusted", suspect: "suspected", quarantined: "quarantined" }),
    quantities: /** @type {Words} */ ({ yaw: "lidar yaw (rad)", offset_x: "lidar offset x (m)", offset_y: "lidar offset y (m)", range_scale: "range scale", beam_spacing: "beam spacing", way_scale: "odometry scale", turn_scale: "turn scale", turn_per_metre: "turn per metre (rad)", clock: "clock offset (s)" }),
    estimate: (/** @type {string} */ quantity, /** @type {number} */ value, /** @type {number} */ sigma, /** @type {boolean} */ applied) => quantity + " " + value.toPrecision(3) + " ± " + sigma.toPrecision(1) + (applied ? ", corrected" : ""),
    actions: /** @type {Words} */ ({ quarantine: "Quarantine", release: "Release" }),
    asks: /** @type {Record<string, (id: string) => string>} */ ({ quarantine: (id) => "Quarantine " + id + "?", release: (id) => "Release " + id + "?" }),
    says: /** @type {Words} */ ({ quarantine: "What it uploads from now on stays out of the map.", release: "What it uploads from now on goes into the map again." }),
  },
  batches: {
    head: ["Batch", "Vehicle", "Status", "Scans", "Closures", "Received", "Notes"], retry: "Try again", refused: "Refused or not localised", waiting: "Waiting", merged: "In the map",
    statuses: /** @type {Words} */ ({ unanchored: "not localised" }), more: (/** @type {number} */ count) => count + " of those in the map are shown; the API lists all.",
  },
  residuals: {
    label: "What each loop closure added to the optimum", earlier: "Earlier", later: "Later",
    caption: (/** @type {number} */ count, /** @type {number | null} */ threshold) => plural(count, "loop closure", "loop closures") + ", each with what it added to the optimum (ΔF), on a logarithmic scale" + (threshold === null ? "; the series has not converged yet" : "; the dashed line is the paper's threshold, " + threshold.toPrecision(3)),
    entry: (/** @type {import("./types").ResidualEntry} */ entry) => "closure " + entry.n + ", edge " + entry.edge_id + ": ΔF " + entry.delta_f.toPrecision(3) + ", p " + entry.p_value.toPrecision(2),
  },
  versions: {
    title: (/** @type {number} */ version) => "Version " + version, current: "grows with every pass", began: "Began", ended: "Ended", released: "Released", retired: "Retired", cause: "Because", by: "By", moved: "Poses moved", hash: "SHA-256 of the PGM", files: "Files", onMap: "Show on the map",
    states: /** @type {Words} */ ({ draft: "draft", released: "released", retired: "retired" }), causes: /** @type {Words} */ ({ accept: "a change was accepted", undo: "a decision was undone", release: "a version was released" }),
    actions: /** @type {Words} */ ({ release: "Release", retire: "Retire" }),
    asks: /** @type {Record<string, (version: number) => string>} */ ({ release: (version) => "Release version " + version + "?", retire: (version) => "Retire version " + version + "?" }),
    says: /** @type {Words} */ ({ release: "Its map is frozen as it is now and offered to vehicles; it never changes again.", retire: "Vehicles are no longer to use it. Its files stay." }),
    done: /** @type {Record<string, (version: number) => string>} */ ({ release: (version) => "Version " + version + " is released", retire: (version) => "Version " + version + " is retired" }),
    difference: (/** @type {number} */ before) => "What differs from version " + before, numbers: "The difference in numbers", accepted: "Alerts accepted",
    cells: /** @type {Words} */ ({ to_occupied: "Cells now occupied", to_free: "Cells now free", to_unknown: "Cells now unknown", from_unknown: "Cells newly observed" }),
  },
  settings: {
    name: "Name", rate: "False alerts accepted per lap", hold: "A batch waits for its predecessor, seconds", shift: "A batch may move the map by at most, metres", save: "Save", saved: "Saved", stage: "Stage", detector: "Detector", waiting: "Batches waiting",
    counts: /** @type {Words} */ ({ batches: "Batches", scans: "Scans", nodes: "Nodes", edges: "Edges", loop_closures: "Loop closures", subgraphs: "Sub-graphs", vehicles: "Vehicles", open_alerts: "Alerts to decide" }),
  },
  zones: "Muted zones", noZones: "No place is muted.", zoneHead: ["Where", "Kinds", "Until", "By", "Note", "Decide"], endZone: "End", forGood: "for good",
  audit: { head: ["When", "Who", "What", "Of what"], csv: "All of it as CSV", more: (/** @type {number} */ count) => "The newest " + count + " are shown." },
  report: {
    title: "Shift report", period: "Period", periods: /** @type {[string, string][]} */ ([["8", "the last 8 hours"], ["12", "the last 12 hours"], ["24", "the last day"], ["168", "the last week"]]), again: "Refresh", print: "Print",
    raised: "Raised", decided: "Decided", open: "Still open", dismissals: "Why alerts were dismissed", none: "None.", truncated: "There is more than is shown: choose a shorter period.",
    alertHead: ["Alert", "Route", "Where", "Way", "Status", "With", "Raised"], decidedHead: ["Alert", "Route", "Decision", "By", "Why", "When"], dismissalHead: ["Route", "Kind", "Reason", "Alerts"],
    counts: /** @type {Words} */ ({ raised: "raised", decided: "decided", open: "still open", muted: "muted" }),
  },
  help: "Keys",
  helpRows: /** @type {[string, string][]} */ ([["j, k", "next, previous alert"], ["a", "accept"], ["d", "dismiss"], ["e", "acknowledge"], ["u", "undo or reopen"], ["x", "choose for deciding several"], ["/", "search"], ["?", "this list"], ["Esc", "close, leave a field"], ["arrows, +, −, 0", "move, zoom and fit the map when it has the focus"]]),
};
