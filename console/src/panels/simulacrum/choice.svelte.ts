// Which robots are mirrored at this hub: the channels named `simulacrum`.
import type { Hub } from "../../hub/hub.svelte.js";
import { contexts } from "../../hub/selection.svelte.js";

const NAME = "simulacrum";

export class Choice {
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
}
