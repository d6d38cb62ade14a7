import { define } from "../../element.svelte.js";
import "../calibrate/index.js";
import "../cameras/index.js";
import "../chat/index.js";
import "../commands/index.js";
import "../jog/index.js";
import "../notices/index.js";
import "../objects/index.js";
import "../token/index.js";
import Drive from "./Drive.svelte";
import css from "./drive.css?inline";

define("mom-drive", Drive, css);
