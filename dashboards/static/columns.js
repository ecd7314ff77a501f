// The columns of the table of trials: what the service calls each, what people read, and how a cell is written.
import { amount, duration, feature, moment, number, stateText } from "./format.js";
import { element } from "./plain.js";

const DEGREES = 180 / Math.PI;
const words = (text) => text.replaceAll("_", " ");
const link = (address, text) => element("a", { href: address, textContent: text });

// `rare` columns are shown when somebody chooses them.
export function columnsOf({ base, behaviour, units, space, value, hasDifficulty, staged = false }, { parameters = [], details = [], troubled = false } = {}) {
  const title = value.title[0].toUpperCase() + value.title.slice(1);
  const unitOf = (name) => (units[name] ? ` (${units[name]})` : "");
  const columns = [
    { key: "number", head: "#", num: true, cell: (t) => link(`${base}/trials/${t.number}`, t.number), text: (t) => String(t.number) },
    {
      key: "state", head: "State", text: (t) => `${stateText(t.state)}${t.retries ? ` ↻ ${t.retries}` : ""}`,
      cell: (t) => element("span", {}, element("span", { className: "state", dataset: { state: t.state }, textContent: stateText(t.state) }),
        ...(t.retries ? [element("span", { className: "state", dataset: { state: "lost" }, textContent: ` ↻ ${t.retries}`, title: `${t.retries} ${t.retries === 1 ? "attempt was" : "attempts were"} lost or failed` })] : [])),
    },
    { key: "value", head: title, num: true, text: (t) => number(t.value) },
  ];
  // What a jump is called says more than four coordinates of its rotation.
  const named = details.some((one) => one.name === "name");
  if (named) columns.push({ key: "details.name", head: "Strategy", text: (t) => plain(t.details.name ?? "") });
  for (const [index, name] of (behaviour?.names ?? []).entries()) {
    const unit = behaviour.kind === "rotation" ? "" : behaviour.unit;
    columns.push({
      key: `features.${index}`, also: [`feature.${name}`, name], head: (behaviour.kind === "rotation" ? `rotation ${name}` : words(name)) + (unit && unit !== "rad" ? ` (${unit})` : ""), num: true, rare: behaviour.kind === "rotation", scale: unit === "rad" ? 1 / DEGREES : 1,
      text: (t) => (t.features ? feature(t.features[index], unit === "rad" ? unit : "") : "–"),
    });
  }
  if (hasDifficulty) columns.push({ key: "z", head: "Difficulty", num: true, text: (t) => number(t.z, 3) });
  for (const name of new Set([...Object.keys(space), ...parameters])) {
    columns.push({ key: `params.${name}`, head: name + unitOf(name), num: space[name]?.type !== "categorical", text: (t) => number(t.params[name] ?? null) });
  }
  columns.push(
    { key: "mode", head: "Proposed to", text: (t) => (typeof t.info.mode === "string" ? t.info.mode : "") },
    { key: "warm_start", head: "Starts from", num: true, rare: !hasDifficulty, text: (t) => (t.warm_start === null ? "" : String(t.warm_start)), cell: (t) => (t.warm_start === null ? "" : link(`${base}/trials/${t.warm_start}`, t.warm_start)) },
    { key: "samples", head: "Samples", num: true, text: (t) => amount(t.cost.samples) },
    { key: "seconds", head: "Training time", num: true, text: (t) => duration(t.cost.seconds) },
    { key: "attempts", head: "Attempts", num: true, rare: true, text: (t) => String(t.attempts) },
    { key: "retries", head: "Lost or failed attempts", num: true, rare: true, text: (t) => String(t.retries) },
    { key: "iteration", head: "Iteration", num: true, rare: true, text: (t) => number(t.iteration) },
    { key: "position", head: "Finished as", num: true, rare: true, text: (t) => number(t.position) },
    { key: "stage", head: "Stage", rare: !staged, text: (t) => t.stage },
    { key: "created_at", head: "Proposed", rare: true, text: (t) => moment(t.created_at) },
    { key: "started_at", head: "Started", rare: true, text: (t) => (t.started_at ? moment(t.started_at) : "–") },
    { key: "finished_at", head: "Finished", rare: true, text: (t) => (t.finished_at ? moment(t.finished_at) : "–") },
    { key: "message", head: "What went wrong", rare: !troubled, text: (t) => t.message },
  );
  for (const { name, num } of details) if (name !== "name") columns.push({ key: `details.${name}`, head: words(name), num, rare: true, text: (t) => plain(t.details[name]) });
  return columns;
}

function plain(value) { return value !== null && typeof value === "object" ? JSON.stringify(value) : number(value ?? null); }

const CONDITION = /^\s*(.+?)\s*(<=|>=|!=|=|<|>|~)\s*(.*?)\s*$/;
const PREFIX = /^(params|details|features)\.[^.]/;

// `value > 0.5 and omega_x <= -2` as the service takes it; a word without a sign is looked for in state, mode and
// message, a number alone is a trial's. Angles are written in the degrees that the table shows.
export function conditionsOf(text, columns) {
  const found = [];
  for (const part of text.split(/\s+and\s+|\s*;\s*/i).filter((one) => one.trim())) {
    const parsed = CONDITION.exec(part);
    if (!parsed) {
      found.push(/^\s*#?\d+\s*$/.test(part) ? `number=${part.replace("#", "").trim()}` : `text~${part.trim()}`);
      continue;
    }
    const [, name, sign, value] = parsed;
    const of = (column) => [column.key, column.key.split(".").at(-1), column.head.toLowerCase(), ...(column.also ?? [])];
    const column = columns.find((one) => one.key === name) ?? columns.find((one) => of(one).includes(name)) ?? columns.find((one) => of(one).includes(name.toLowerCase()));
    if (!column && !PREFIX.test(name) && name !== "text") return { conditions: [], problem: `Unknown column ${name}. Known: ${columns.map((one) => one.also?.[1] ?? one.key).join(", ")}` };
    const degrees = Number(value.replace(/°\s*$/, "").replace("−", "-"));
    const scaled = column?.scale && column.scale !== 1 && value && Number.isFinite(degrees) ? String(degrees * column.scale) : value;
    found.push(`${column?.key ?? name}${sign}${scaled}`);
  }
  return { conditions: found, problem: "" };
}
