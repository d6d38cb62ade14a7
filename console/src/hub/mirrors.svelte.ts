// Which robots are mirrored at this hub: the channels named `simulacrum`, one in each robot's session.
import type { Hub } from "./hub.svelte.js";
import { contexts } from "./selection.svelte.js";
import { whileVisible } from "./visible.js";

const NAME = "simulacrum";
/** ms until it is looked again whether a robot is mirrored, as long as there is none. */
const AGAIN = 10_000;

/** The session of a mirrored robot, by which people know it. */
export const robotOf = (path: string): string => path.slice(0, path.lastIndexOf("/"));

export class Mirrors {
  paths = $state.raw<readonly string[]>([]);
  looking = $state(false);
  looked = $state(false);

  constructor(readonly hub: Hub) {}

  async look(): Promise<void> {
    if (this.looking || !this.hub.isUp) return;
    this.looking = true;
    const found = await contexts(this.hub).catch(() => []);
    this.paths = found.filter(({ kind, path }) => kind === "channel" && path.endsWith(`/${NAME}`)).map(({ path }) => path);
    [this.looking, this.looked] = [false, true];
  }

  /** Looks again and again as long as there is none, until the function that it gives is called. */
  start(): () => void {
    return whileVisible(AGAIN, () => (this.paths.length ? undefined : this.look()));
  }
}
