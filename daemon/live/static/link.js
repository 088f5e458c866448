// The connection to touchd: opened, watched, and reopened until it works.

const FIRST_RETRY_MS = 250;
const LONGEST_RETRY_MS = 4000;
// touchd sends its status twice a second; after this long without a message, the connection is lost.
const SILENCE_MS = 2500;

/**
 * Hand over each message as it comes: events and the like as objects, frames as ArrayBuffer.
 * onState gets the reason when the connection is lost. Returns a function that sends a message.
 */
export function connect(onMessage, onState) {
  let socket = null;
  let retryMs = FIRST_RETRY_MS;
  let retry = 0;
  let silence = 0;

  function open() {
    clearTimeout(retry);
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const opened = new WebSocket(`${scheme}//${location.host}/stream`);
    socket = opened;
    opened.binaryType = "arraybuffer";
    opened.onmessage = ({ data }) => {
      if (socket !== opened) return;
      retryMs = FIRST_RETRY_MS;
      expectMore();
      onMessage(typeof data === "string" ? JSON.parse(data) : data);
    };
    opened.onclose = (event) => {
      if (socket === opened) lose(event.reason);
    };
    expectMore();
  }

  function expectMore() {
    clearTimeout(silence);
    silence = setTimeout(() => lose(""), SILENCE_MS);
  }

  function lose(reason) {
    const lost = socket;
    socket = null;
    clearTimeout(silence);
    lost?.close();
    onState(reason);
    // Pages that lost the same daemon should not all come back in the same instant.
    retry = setTimeout(open, retryMs * (0.8 + 0.4 * Math.random()));
    retryMs = Math.min(retryMs * 1.7, LONGEST_RETRY_MS);
  }

  // Timers sleep in a hidden page; once it is shown again, do not wait for them.
  document.addEventListener("visibilitychange", () => {
    if (!document.hidden && socket === null) open();
  });
  open();
  return (message) => {
    if (socket?.readyState === WebSocket.OPEN) socket.send(message);
  };
}
