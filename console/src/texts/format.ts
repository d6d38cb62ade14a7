// Numbers as people read them.

/** The time of day, `14:03:59`. */
export function timeOfDay(ms: number): string {
  return new Date(ms).toLocaleTimeString(undefined, { hour12: false });
}

/** `180 ms`, `1.2 s`, `3 min 5 s`. */
export function duration(ms: number): string {
  const size = Math.abs(ms);
  if (size < 10) return `${ms.toFixed(1)} ms`;
  if (size < 1000) return `${Math.round(ms)} ms`;
  if (size < 10_000) return `${(ms / 1000).toFixed(1)} s`;
  if (size < 60_000) return `${Math.round(ms / 1000)} s`;
  const seconds = Math.round(ms / 1000);
  if (size < 3_600_000) return seconds % 60 ? `${Math.floor(seconds / 60)} min ${seconds % 60} s` : `${seconds / 60} min`;
  const minutes = Math.round(ms / 60_000);
  if (size < 86_400_000) return minutes % 60 ? `${Math.floor(minutes / 60)} h ${minutes % 60} min` : `${minutes / 60} h`;
  return `${(ms / 86_400_000).toFixed(1)} d`;
}

/** Time that runs down, in whole seconds. */
export function left(ms: number): string {
  return duration(Math.ceil(Math.max(0, ms) / 1000) * 1000);
}

/** `120 ms ± 2 ms`; without an error the age is not known. */
export function age(ms: number, error: number | undefined): string {
  return error === undefined ? duration(ms) : `${duration(ms)} ± ${duration(Math.max(error, 0.1))}`;
}

/** `1.5 KiB`. */
export function bytes(count: number): string {
  const units = ["B", "KiB", "MiB", "GiB", "TiB"];
  let [size, unit] = [count, 0];
  while (size >= 1024 && unit < units.length - 1) [size, unit] = [size / 1024, unit + 1];
  return `${unit === 0 || size >= 100 ? Math.round(size) : size.toFixed(1)} ${units[unit]}`;
}

export function count(number: number): string {
  return Math.round(number).toLocaleString("en");
}

/** Per second. */
export function rate(number: number): string {
  return `${number >= 100 ? Math.round(number).toLocaleString("en") : number.toFixed(number >= 10 ? 0 : 1)}/s`;
}

/** The lower part of a fence, which people tell each other. */
export function fence(number: number): string {
  return `${number % 2 ** 20}`;
}

/** `14:03:09.250`. */
export function clock(ms: number): string {
  const date = new Date(ms);
  const two = (number: number): string => String(number).padStart(2, "0");
  return `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}.${String(date.getMilliseconds()).padStart(3, "0")}`;
}

/** `2026-11-24 14:03:09.250`, in the time of this machine. */
export function moment(ms: number): string {
  const date = new Date(ms);
  const two = (number: number): string => String(number).padStart(2, "0");
  return `${date.getFullYear()}-${two(date.getMonth() + 1)}-${two(date.getDate())} ${clock(ms)}`;
}
