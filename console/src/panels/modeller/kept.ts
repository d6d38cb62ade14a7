// The model that is being made survives a reload of the page.
import { type Draft, FIELDS, MODEL_FIELDS, blank, emptyDraft } from "./model.js";

const PLACE = "mom-modeller";

const text = (value: unknown): string => (typeof value === "string" ? value : "");

export function keep(draft: Draft): void {
  try {
    localStorage.setItem(PLACE, JSON.stringify(draft));
  } catch {
    // A browser without storage keeps nothing.
  }
}

/** What was kept; a small model if there is none. */
export function kept(): Draft {
  try {
    return draftOf(JSON.parse(localStorage.getItem(PLACE) ?? "null")) ?? emptyDraft();
  } catch {
    return emptyDraft();
  }
}

/** A draft of what was stored, whatever that is. */
export function draftOf(stored: unknown): Draft | undefined {
  if (typeof stored !== "object" || stored === null) return undefined;
  const from = stored as { [key: string]: unknown };
  if (!Array.isArray(from["elements"])) return undefined;
  const elements = (from["elements"] as unknown[]).flatMap((row, index) => {
    if (typeof row !== "object" || row === null) return [];
    const fields = row as { [key: string]: unknown };
    return [blank(index + 1, Object.fromEntries(FIELDS.map((field) => [field, text(fields[field])])))];
  });
  const [name, id, period, largest, watchdog, doc] = MODEL_FIELDS.map((field) => text(from[field])) as [string, string, string, string, string, string];
  return { name, id, period, largest, watchdog, doc, elements };
}
