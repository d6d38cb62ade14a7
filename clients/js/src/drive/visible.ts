// Text of others as people may see it.

/** What moves a cursor, begins a line, or turns the direction of writing. */
const UNSEEN = /[\u0000-\u001f\u007f-\u009f\u200e\u200f\u2028-\u202e\u2066-\u2069]/g;
const KNOWN: Record<string, string> = { "\t": " ", "\n": "\\n", "\r": "\\r" };

/** Text of others, safe to show on one line. */
export function visible(text: string): string {
  return text.replace(UNSEEN, (letter) => KNOWN[letter] ?? `\\u{${letter.charCodeAt(0).toString(16)}}`);
}
