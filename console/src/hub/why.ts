// Why a hub cannot be reached, which a browser does not say of a WebSocket.
import { texts } from "../texts/index.js";

/** Where the hub answers HTTP, of each address. */
function pagesOf(address: string): string[] {
  const found = address.split(/\s+/).flatMap((door) => {
    const url = /^(ws|http)(s?):\/\/[^/]+/.exec(door);
    return url ? [`${url[0].replace(/^ws/, "http")}`] : [];
  });
  return [...new Set(found)];
}

/** What the hub says to pages of this origin, where it lets none in; null if it does not answer at all, or lets them in. */
export async function whyNot(address: string): Promise<string | null> {
  for (const hub of pagesOf(address)) {
    const same = hub === location.origin;
    try {
      const answer = await fetch(`${hub}/api/logout`, { method: "POST", credentials: "omit", ...(same ? {} : { mode: "cors" }) });
      // A page that is let in may read the answer, whatever it says.
      if (answer.status !== 403) return null;
      const said = (await answer.json()) as { text?: unknown };
      return typeof said.text === "string" ? said.text : null;
    } catch {
      if (same || !(await answers(hub))) continue;
      return texts.login.notListed(location.origin);
    }
  }
  return null;
}

/** Whether a server answers of which this page may read nothing. */
async function answers(hub: string): Promise<boolean> {
  try {
    await fetch(`${hub}/healthz`, { mode: "no-cors", credentials: "omit", cache: "no-store" });
    return true;
  } catch {
    return false;
  }
}
