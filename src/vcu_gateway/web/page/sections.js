// Each section as the views need it. What is not as it should be is absent here, and no mistake later.

const isObject = (value) => value !== null && typeof value === "object" && !Array.isArray(value);
const object = (value) => (isObject(value) ? value : {});
const list = (value) => (Array.isArray(value) ? value : []);
const text = (value) => (typeof value === "string" ? value : "");
const number = (value) => (typeof value === "number" ? value : null);
const truth = (value) => (typeof value === "boolean" ? value : null);
const each = (value, read) => Object.fromEntries(Object.entries(object(value)).map(([name, one]) => [name, read(object(one))]));
const all = (value, read) => list(value).filter(isObject).map(read);
const texts = (value) => list(value).filter((one) => typeof one === "string");

const frame = (value) => (isObject(value) ? { frame: text(value.frame), age_ms: number(value.age_ms) } : null);

const command = (one) => ({
  throttle_pct: number(one.throttle_pct),
  brake_pct: number(one.brake_pct),
  speed_limit_rpm: number(one.speed_limit_rpm),
  power_limit_w: number(one.power_limit_w),
  power_mode: text(one.power_mode) || null,
  motor_reverse: truth(one.motor_reverse),
  regen_brake: truth(one.regen_brake),
  power_cut: truth(one.power_cut),
  decided: text(one.decided) || null,
  sent: frame(one.sent),
  echoed: frame(one.echoed),
});

const controllerStop = (one) => ({
  sent_ms: number(one.sent_ms),
  echoed_ms: number(one.echoed_ms),
  obeyed: truth(one.obeyed),
  power_cut: text(one.power_cut),
  throttle_pct: number(one.throttle_pct),
  missing: text(one.missing),
});

/** Null where no CUT is latched, undefined where the gateway does not tell. */
function stop(value) {
  if (value == null) return value;
  const one = object(value);
  const sentence = text(one.sentence) || "Stop latched; what became of it was not understood";
  return { stage: text(one.stage), sentence, reason: text(one.reason), controllers: each(one.controllers, controllerStop) };
}

const state = (one) => ({
  t: number(one.t),
  mode: text(one.mode),
  messages: Object.fromEntries(Object.entries(object(one.messages)).filter(([, row]) => Array.isArray(row))),
  commands: each(one.commands, command),
  stop: stop(one.stop),
});

const cause = (one) => ({
  cause: text(one.cause),
  subject: text(one.subject),
  detail: text(one.detail),
  effect: text(one.effect),
  since_ms: number(one.since_ms),
  stands: one.stands,
});

const latch = (one) => ({ fault_class: text(one.fault_class), reason: text(one.reason) });
const demand = (one) => ({ source: text(one.source), age_ms: number(one.age_ms), fresh: truth(one.fresh) });

const why = (one) => ({
  t: number(one.t),
  sentence: text(one.sentence),
  summary: text(one.summary), // an older gateway has none
  mode: text(one.mode),
  latch: isObject(one.latch) ? latch(one.latch) : null,
  blocks: all(one.blocks, cause),
  limits: all(one.limits, cause),
  alarms: all(one.alarms, cause),
  waits: texts(one.waits),
  demand: isObject(one.demand) ? demand(one.demand) : null,
  next_step: text(one.next_step),
});

const event = (one) => ({
  name: text(one.name),
  severity: text(one.severity),
  fields: object(one.fields),
  count: number(one.count),
  time: text(one.time) || text(one.last_time),
});

const link = (one) => ({
  problem: text(one.problem) || null,
  certificate: text(one.certificate),
  not_understood: texts(one.not_understood),
  versions: object(one.versions),
});

const signal = (one) => ({
  name: text(one.name),
  unit: text(one.unit),
  minimum: number(one.minimum) ?? 0,
  maximum: number(one.maximum) ?? 0,
  factor: number(one.factor) || 1,
  names: object(one.names),
  comment: text(one.comment),
});
const message = (one) => ({ name: text(one.name), sender: text(one.sender), id: text(one.id), signals: all(one.signals, signal) });

const READERS = {
  state,
  why,
  link,
  health: object,
  events: (one) => ({ gateway: all(one.gateway, event), page: all(one.page, event) }),
  definition: (one) => ({ messages: all(one.messages, message) }),
};

export const SECTIONS = Object.keys(READERS);
export const readSection = (section, value) => READERS[section](object(value));
