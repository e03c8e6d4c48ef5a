// The bodies of the API that the console reads, as openapi/openapi.json has them. Only for the type checker.

export interface Point { x: number; y: number }
export interface Pose extends Point { theta: number }
export type Corner = [number, number];

export interface HistoryEntry { status: string; at: string; by: string; note: string | null; reason?: string | null }
export interface PassCounts { saw_free: number; saw_occupied: number; could_not_see: number }

export interface Alert {
  id: string;
  route_id: string;
  revision: number;
  decision_revision: number;
  kind: string;
  status: string;
  tier: string;
  actions: string[];
  confidence: number;
  title?: string;
  summary?: string;
  size?: { length: number; width: number } | null;
  blocking?: string | null;
  passes?: { before: PassCounts; since: PassCounts } | null;
  muted?: boolean;
  muted_until?: string | null;
  assignee?: string | null;
  comments?: number;
  location: Point & { sigma: number };
  region: Corner[];
  counterpart: { kind: string; region: Corner[] } | null;
  shift: Point | null;
  suspect: { faults: { text: string }[] } | null;
  bands: { from: number; to: number }[];
  edge_ids: number[];
  node_ids: number[];
  vehicle_ids: string[];
  trip_ids: string[];
  views: number;
  laps: number;
  residual: { edge_id: number; delta_f: number; threshold: number | null; p_value: number } | null;
  since: string;
  last_seen: string;
  until: string | null;
  raised_at: string;
  map_version: number;
  history: HistoryEntry[];
}

export interface RouteSettings { detector: string; false_alarm_rate: number; hold_s: number; max_shift_m: number }

export interface Route {
  id: string;
  display_name: string | null;
  stage: string;
  map_version: number;
  counts: Record<string, number>;
  pending_batches: number;
  settings: RouteSettings;
}

export interface Session { open: boolean; name: string | null; role: string | null; routes?: string[] | null }

export interface Pass {
  trip_id: string;
  vehicle_id: string;
  begins_at: string;
  ends_at: string;
  side: "before" | "since";
  outcome: "old_state" | "new_state" | "could_not_see";
  node_id: number | null;
}

export interface Preview {
  decision_revision: number;
  nodes_reactivated?: number;
  map_version_next: number;
  cells: { to_free: number; to_occupied: number; to_unknown: number; from_unknown: number };
  edges_retired: number;
  edge_ids: number[];
  nodes_handed_over: number;
  max_displacement_m: number;
  region: Corner[];
}

export interface Comment { id?: string | number; at: string; by: string; text: string }

export interface Version {
  version: number;
  created_at: string;
  superseded_at: string | null;
  current: boolean;
  state?: string;
  sha256: string | null;
  cause: { action: string; alert_id: string | null; by?: string | null; note?: string | null } | null;
  max_displacement_m?: number | null;
  released?: { at: string; by: string; note: string | null } | null;
  retired_at?: string | null;
}

export interface VersionDifference { from: number; to: number; cells: Record<string, number>; alerts: string[] }

export interface TilesInfo { min_zoom: number; max_zoom: number; bounds: [number, number, number, number]; tag?: string }

export interface NodeScan {
  node_id: number;
  pose: Pose;
  stamp: string;
  lidar: { angle_min: number; angle_increment: number; mount: Pose };
  ranges: (number | null)[];
}

export interface Zone {
  id: string;
  polygon: Corner[];
  purpose: string;
  kinds: string[] | null;
  until: string | null;
  note: string | null;
  created_at: string;
  created_by: string;
}

export interface Estimate { value: number; sigma: number; sure: boolean; applied: boolean }

export interface Vehicle {
  id: string;
  state: string;
  reasons: string[];
  last_seen: string | null;
  counts: { batches: number; scans: number; trips: number };
  calibration: Record<string, Estimate | string[] | number | null>;
}

export interface Batch {
  id: string;
  vehicle_id: string;
  trip_id: string;
  status: string;
  reason: string | null;
  flags: string[];
  scans: number;
  loop_closures: number;
  received_at: string;
}

export interface ResidualEntry { n: number; edge_id: number; delta_f: number; threshold: number | null; p_value: number; verdict: string }
export interface ResidualSeries { entries: ResidualEntry[]; threshold: number | null }

export interface AuditEntry { id: number; at: string; actor: string; action: string; subject: string; route_id: string | null }

export interface Operation { id: string; status: string; ended_at: string | null; progress: number; reason: string | null; result: any }

/** An alert in a report: less than an alert has. */
export interface ReportAlert extends Point { id: string; route_id: string; kind: string; status: string; tier: string; raised_at: string; assignee: string | null; muted: boolean }

export interface Report {
  since: string;
  until: string;
  raised: ReportAlert[];
  decided: { alert: string; route_id: string; kind: string; action: string; by: string; at: string; reason: string | null; note: string | null }[];
  open: ReportAlert[];
  dismissals: { route_id: string; kind: string; reason: string | null; count: number }[];
  counts: Record<string, number>;
  truncated: boolean;
}
