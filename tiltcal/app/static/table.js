// A table of text: what comes from files cannot be markup. A row may be picked, by mouse or keyboard.
export default {
  template: `
    <div class="wide"><table class="grid">
      <caption v-if="caption">{{ caption }}</caption>
      <thead><tr><th v-for="c in columns" :class="c.kind" scope="col">{{ c.label }}</th></tr></thead>
      <tbody><tr v-for="(row, i) in rows" :class="{ picked: picked.includes(i), pickable: pickable }" @click="pickable && $emit('pick', row[0])">
        <td v-for="(cell, k) in row" :class="columns[k].kind">
          <button v-if="pickable && k === 0" type="button" class="pick" :aria-pressed="picked.includes(i) ? 'true' : 'false'" @click.stop="$emit('pick', row[0])">{{ cell }}</button>
          <span v-else-if="columns[k].kind === 'mark'" :class="['mark', tone(cell)]">{{ cell }}</span>
          <template v-else>{{ cell }}</template>
        </td></tr></tbody>
    </table><p v-if="!rows.length" class="soft">{{ empty }}</p></div>`,
  props: { columns: Array, rows: Array, caption: String, empty: String, pickable: Boolean, picked: Array },
  methods: {
    tone(cell) {
      if (["good", "passed", "yes", "match", "done"].includes(cell)) return "yes";
      return ["FAILED", "no", "suspect", "failed"].includes(cell) ? "no" : "mid";
    },
  },
};
