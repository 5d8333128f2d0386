// Applies the stream of changed values to the page. Every text from the server becomes textContent, never markup.
(() => {
  'use strict';
  const SILENT = 450; // after which the page is grey [ms]
  const LOOK = 50; // between two looks whether it is [ms]
  const RETRY = 500; // between two attempts to connect [ms]
  const RELOAD = 2000; // between two reloads [ms]
  let last = performance.now();
  let retrying = 0;
  let layout; // that the server last asked for
  let socket;
  let expiring = []; // timers

  const fields = (key) => document.querySelectorAll(`[data-field="${CSS.escape(key)}"]`);
  const own = (object) => Object.entries(object || {});

  function cell(value, row) { // a text, or an object of text and state
    const element = row.insertCell();
    const plain = typeof value === 'string';
    if (!plain) element.dataset.state = value.state;
    element.textContent = plain ? value : value.text;
  }

  function table(body, rows) {
    const text = JSON.stringify(rows);
    if (body.dataset.shown === text) return;
    body.dataset.shown = text;
    body.replaceChildren();
    const english = (body.dataset.english || '').split(' ');
    for (const cells of rows) {
      const row = body.insertRow();
      for (const value of cells) cell(value, row);
      for (const column of english) if (column) row.cells[column].lang = 'en';
    }
  }

  function chart(name, option) {
    for (const element of document.querySelectorAll(`.chart-${CSS.escape(name)}`)) {
      const component = getElement(Number(element.id.slice(1)));
      if (component && component.chart) component.chart.setOption(option, { lazyUpdate: true });
    }
  }

  // viridis (matplotlib), eight of its colours
  const COLOURS = [[68, 1, 84], [70, 50, 127], [54, 92, 141], [39, 127, 142], [31, 161, 135], [74, 194, 109],
    [159, 218, 58], [253, 231, 37]];
  function colour(level) {
    const position = Math.max(0, Math.min(0.999, level)) * (COLOURS.length - 1);
    const index = Math.floor(position), part = position - index;
    return COLOURS[index].map((value, i) => value + part * (COLOURS[index + 1][i] - value));
  }

  function waterfall(canvas, levels) { // levels: 0 ... 255, one row
    if (canvas.width !== levels.length) canvas.width = levels.length;
    const context = canvas.getContext('2d');
    context.drawImage(canvas, 0, 1);
    const row = context.createImageData(levels.length, 1);
    levels.forEach((level, i) => row.data.set([...colour(level / 255), 255], 4 * i));
    context.putImageData(row, 0, 0);
  }

  function apply(message) {
    const content = document.querySelector('.content[data-live]');
    if (!content) return;
    if (message.layout !== undefined) layout = message.layout;
    if (layout !== undefined && content.dataset.layout !== layout) { // a station or pair is new
      if (Date.now() - Number(sessionStorage.getItem('reloaded')) > RELOAD) { // else with a later message
        sessionStorage.setItem('reloaded', String(Date.now()));
        location.reload();
        return;
      }
    }
    for (const timer of expiring) clearTimeout(timer);
    expiring = (message.expire || []).map((then) => setTimeout(() => show(then), 1000 * then.after));
    show(message);
  }

  function show(message) {
    for (const [key, text] of own(message.text)) {
      for (const element of fields(key)) if (element.textContent !== text) element.textContent = text;
    }
    for (const [key, state] of own(message.state)) {
      for (const element of fields(key)) if (element.dataset.state !== state) element.dataset.state = state;
    }
    for (const [key, attributes] of own(message.attributes)) {
      for (const element of fields(key)) {
        for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
      }
    }
    for (const [key, rows] of own(message.rows)) for (const body of fields(key)) table(body, rows);
    for (const [name, option] of own(message.chart)) chart(name, option);
    for (const [key, levels] of own(message.waterfall)) for (const canvas of fields(key)) waterfall(canvas, levels);
  }

  function connect() {
    retrying = 0;
    const content = document.querySelector('.content[data-live]');
    if (!content) { // NiceGUI has not mounted the page yet
      retrying = setTimeout(connect, 20);
      return;
    }
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    socket = new WebSocket(`${scheme}://${location.host}/live?${content.dataset.live}`);
    socket.onmessage = (event) => {
      last = performance.now();
      document.documentElement.dataset.lost = 'false';
      apply(JSON.parse(event.data));
    };
    socket.onclose = () => {
      if (!retrying) retrying = setTimeout(connect, RETRY);
    };
  }

  document.addEventListener('click', (event) => { // another option of the stream
    const chosen = event.target.closest('[data-option]');
    if (!chosen) return;
    const content = document.querySelector('.content[data-live]');
    const options = new URLSearchParams(content.dataset.live);
    options.set(chosen.dataset.option, chosen.dataset.value);
    content.dataset.live = options.toString();
    for (const button of chosen.parentElement.children) button.ariaPressed = String(button === chosen);
    if (socket) socket.onclose = null;
    if (socket) socket.close();
    if (!retrying) connect();
  });

  setInterval(() => {
    const silent = performance.now() - last;
    if (silent < SILENT) return;
    document.documentElement.dataset.lost = 'true';
    const language = document.querySelector('.page').lang;
    const seconds = new Intl.NumberFormat(language, { minimumFractionDigits: 1, maximumFractionDigits: 1 });
    for (const element of fields('lost')) element.textContent = `${seconds.format(silent / 1000)} s`;
  }, LOOK);

  window.addEventListener('pagehide', () => { clearTimeout(retrying); retrying = -1; });
  connect();
})();
