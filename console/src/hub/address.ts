// Where the hub is.

/** The doors of the hub that serves these files, and of no other. */
export function ownAddress(): string {
  // Files of a development server are not the hub's; its page is.
  const { protocol, host } = new URL(import.meta.url);
  const s = protocol === "https:" ? "s" : "";
  return `ws${s}://${host} http${s}://${host}`;
}
