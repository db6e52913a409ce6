// Number formatting.

const grouped = text => text.replace(/\B(?=(\d{3})+$)/g, ",");

/** Format an integer: 1,234,567. */
export const count = n => (Number.isFinite(n) ? grouped(String(Math.round(n))) : "–");

/** Format with three significant digits: 0.00123, 1.23, 123, 12,346. */
export function number(n) {
  if (n === null || n === undefined) return "–";
  if (!Number.isFinite(n)) return n > 0 ? "∞" : n < 0 ? "−∞" : "–";
  const size = Math.abs(n);
  if (size !== 0 && (size < 1e-3 || size >= 1e9)) return n.toExponential(2).replace("-", "−");
  if (size >= 1000 || (Number.isInteger(n) && size < 1e9)) {
    return (n < 0 ? "−" : "") + count(size);
  }
  return String(Number(n.toPrecision(3))).replace("-", "−");
}

/** Format a coordinate or distance with six significant digits. */
export const coordinate = n => (Number.isFinite(n) ? String(Number(n.toPrecision(6))) : number(n));

export const point = p => (p ? p.map(coordinate).join(", ") : "–");

/** The same with four digits, for a table. */
export const shortPoint = p => (p ? p.map(n => String(Number(n.toPrecision(4)))).join(", ") : "–");

/** Format a large number with a unit: 12.3 M. */
export function many(n) {
  if (!Number.isFinite(n)) return "–";
  const units = [[1e9, " G"], [1e6, " M"], [1e3, " k"]];
  for (const [unit, name] of units) if (n >= unit) return (n / unit).toPrecision(3) + name;
  return String(Math.round(n));
}

export function bytes(n) {
  if (!Number.isFinite(n)) return "–";
  const units = [[2 ** 30, "GiB"], [2 ** 20, "MiB"], [2 ** 10, "KiB"]];
  for (const [unit, name] of units) {
    if (n >= unit) return `${(n / unit).toFixed(n >= 100 * unit ? 0 : 1)} ${name}`;
  }
  return `${n} bytes`;
}

export function milliseconds(n) {
  if (!Number.isFinite(n)) return "–";
  return n >= 1000 ? seconds(n / 1000) : `${n >= 100 ? n.toFixed(0) : n.toFixed(1)} ms`;
}

export function seconds(n) {
  if (!Number.isFinite(n)) return "–";
  return n < 1 ? `${(n * 1000).toFixed(n < 0.1 ? 1 : 0)} ms` : `${n.toFixed(n < 10 ? 2 : 1)} s`;
}

/** Turn an identifier into words: "ray_count" becomes "ray count". */
export const words = name => String(name).replaceAll("_", " ");

export const capital = text => text.charAt(0).toUpperCase() + text.slice(1);
