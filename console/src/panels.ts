// All panels, for pages of others: <script type="module" src="https://HUB/panels.js"></script>.
import "./panels/access/index.js";
import "./panels/audit/index.js";
import "./panels/calibrate/index.js";
import "./panels/camera/index.js";
import "./panels/cameras/index.js";
import "./panels/chat/index.js";
import "./panels/commands/index.js";
import "./panels/connection/index.js";
import "./panels/context/index.js";
import "./panels/contexts/index.js";
import "./panels/cursor/index.js";
import "./panels/fleet/index.js";
import "./panels/health/index.js";
import "./panels/jog/index.js";
import "./panels/login/index.js";
import "./panels/modeller/index.js";
import "./panels/notices/index.js";
import "./panels/objects/index.js";
import "./panels/peers/index.js";
import "./panels/simulacrum/index.js";
import "./panels/status/index.js";
import "./panels/stop/index.js";
import "./panels/token/index.js";
import "./panels/tree/index.js";
import "./panels/watch/index.js";

export { hubOf, type Hub } from "./hub/hub.svelte.js";
