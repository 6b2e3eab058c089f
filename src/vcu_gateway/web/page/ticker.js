// A timer that a tab in the background has, too: browsers slow those of pages down, not of workers.
setInterval(() => postMessage(0), 50);
