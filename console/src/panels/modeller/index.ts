import { define } from "../../element.svelte.js";
import Modeller from "./Modeller.svelte";
import css from "./modeller.css?inline";

define("mom-modeller", Modeller, css);
