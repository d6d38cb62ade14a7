// Notices survive a reload of the page: they lie in this tab's storage until the user logs out.
import type { Notice } from "./hub.svelte.js";

const place = (name: string): string => `mom-notices ${name}`;

interface Kept {
  user: string;
  notices: [at: number, tone: Notice["tone"], text: string, code?: string][];
}

export function keepNotices(name: string, user: string, notices: readonly Notice[]): void {
  const kept: Kept = { user, notices: notices.map(({ at, tone, text, failure }) => (failure ? [at, tone, text, failure.code] : [at, tone, text])) };
  try {
    sessionStorage.setItem(place(name), JSON.stringify(kept));
  } catch {
    // For this page only.
  }
}

/** Those of the page that was here before, if it was of the same user. */
export function keptNotices(name: string, user: string): Notice[] {
  try {
    const kept = JSON.parse(sessionStorage.getItem(place(name)) ?? "null") as Kept | null;
    if (kept?.user !== user) return [];
    return kept.notices.map(([at, tone, text, code]) => ({ at, tone, text, ...(code === undefined ? {} : { failure: { kind: "kept", code, text, content: {} } }) }));
  } catch {
    return [];
  }
}

export function forgetNotices(name: string): void {
  try {
    sessionStorage.removeItem(place(name));
  } catch {
    // Nothing was kept.
  }
}
