import { define } from "../../element.svelte.js";
import free from "../../parts/free.css?inline";
import Stop from "./Stop.svelte";
import Stopped from "./Stopped.svelte";
import css from "./stop.css?inline";
import stoppedCss from "./stopped.css?inline";

define("mom-stop", Stop, free + css, ["path", "framed"]);
define("mom-stopped", Stopped, stoppedCss, ["path", "framed"]);
