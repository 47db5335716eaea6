"""The integers of an exported header on a Cortex-M0: bytes of flash and stack by its compiler, and
results and cycles by an emulator that traces each instruction.
"""

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", "-mcpu=cortex-m0")
LINK = ("-mthumb", "-fstack-usage", "-ffunction-sections", "-nostartfiles", "-nostdlib")
CALL = """
#include <stddef.h>
#include "{header}"
unsigned corrected(const int32_t *in, int32_t *f);
unsigned __attribute__((noinline)) corrected(const int32_t *in, int32_t *f)
{{
  {call}
}}
"""
MAIN = """
typedef void (*handler)(void);
extern const handler vectors[2];
void start(void);
const handler vectors[2] __attribute__((section(".vectors"), used)) = {{
  (handler)0x20004000, start
}};
static const int32_t rows[{count}][{inputs}] = {{ {rows} }};
static char line[10] = "00000000\\n";
static void host(int what, const void *given)
{{
  register int r0 __asm__("r0") = what;
  register const void *r1 __asm__("r1") = given;
  __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}}
void __attribute__((noinline)) returned(const int32_t *f);
void returned(const int32_t *f)
{{
  int i, k;
  for (i = 0; i < {outputs}; i++) {{
    for (k = 0; k < 8; k++)
      line[k] = "0123456789abcdef"[((uint32_t)f[i] >> (28 - 4 * k)) & 15u];
    host(4, line);
  }}
}}
void start(void)
{{
  int32_t f[{outputs}];
  int n;
  for (n = 0; n < 10; n++) /* nothing has copied the initial values */
    line[n] = n == 8 ? '\\n' : 0;
  for (n = 0; n < {count}; n++) {{
    (void)corrected(rows[n], f);
    returned(f);
  }}
  host(0x18, (const void *)0x20026);
}}
"""
SCRIPT = """SECTIONS {
  .text 0 : { KEEP(*(.vectors)) *(.text*) *(.rodata*) }
  .data 0x20000000 : { *(.data*) *(.bss*) }
}
"""
CYCLES = {"bl": 4, "b": 3, "ld": 2, "st": 2}
"""Of an instruction: a call, other branches that are taken, loads and stores, and lists of
registers, each of which takes one more; all others one. Without wait states of the flash and with
a multiplier of one cycle. Arm, Cortex-M0 Technical Reference Manual, instruction set summary."""


def missing(program: str) -> str | None:
    """Why something is skipped that needs a program; None where it is there."""
    return None if shutil.which(program) else f"no {program} on this machine"


@dataclass(frozen=True)
class Target:
    """A sensor's function of a header.

    Args:
        header: the file; its folder is written to.
        call: statement that corrects ``in`` into ``f`` and returns the bits.
        only: macro that leaves out floating point.
    """

    header: Path
    call: str
    only: str

    def sizes(self) -> dict[str, int]:
        """Bytes of flash, with what the compiler's library adds, and of the stack, all frames of
        the header's functions together.
        """
        folder = self.header.parent
        self._compile("sized", CALL.format(header=self.header.name, call=self.call), "corrected")
        words = ["arm-none-eabi-size", str(folder / "sized.elf")]
        text = subprocess.run(words, capture_output=True, text=True, check=True).stdout
        (frames,) = [p for p in folder.glob("*.su") if "sized" in p.name]
        stack = sum(int(line.split("\t")[1]) for line in frames.read_text().splitlines())
        return {"flash": int(text.splitlines()[1].split()[0]), "stack": stack}

    def run(self, rows: np.ndarray, outputs: int) -> tuple[np.ndarray, int]:
        """Results of each row, (n, outputs), and the most cycles of one. rows: int32, (n, m)."""
        text = ", ".join("{ " + ", ".join(map(str, row)) + " }" for row in rows.tolist())
        source = CALL.format(header=self.header.name, call=self.call) + MAIN.format(
            count=len(rows), inputs=rows.shape[1], rows=text, outputs=outputs
        )
        program = self._compile("traced", source, "start")
        log = self.header.with_suffix(".log")
        words = [EMULATOR, "-M", "microbit", "-nographic", "-semihosting", "-singlestep"]
        words += ["-d", "exec,nochain", "-D", str(log), "-kernel", str(program)]
        done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
        whole = np.array(
            [int(v, 16) for v in re.findall(r"^[0-9a-f]{8}$", done.stderr + done.stdout, re.M)]
        )
        return whole.astype(np.uint32).astype(np.int32).reshape(-1, outputs), _cycles(program, log)

    def _compile(self, name: str, source: str, entry: str) -> Path:
        folder = self.header.parent
        (folder / f"{name}.c").write_text(source)
        (folder / "flash.ld").write_text(SCRIPT)
        words = [COMPILER, *FLAGS, *LINK, f"-D{self.only}", f"-Wl,--gc-sections,-e,{entry}"]
        words += ["-Wl,-T,flash.ld", f"{name}.c", "-o", f"{name}.elf", "-lgcc"]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        return folder / f"{name}.elf"


def _cycles(program: Path, log: Path) -> int:
    """The most cycles between the entry of ``corrected`` and that of ``returned``."""
    words = ["arm-none-eabi-objdump", "-d", str(program)]
    listing = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    entries = {m[2]: int(m[1], 16) for m in re.finditer(r"^([0-9a-f]+) <(\w+)>:$", listing, re.M)}
    lines = re.findall(r"^\s*([0-9a-f]+):\t[0-9a-f ]+\t(\S+)\t?(.*)$", listing, re.M)
    known = {int(pc, 16): (name, operands) for pc, name, operands in lines}
    order = [int(m, 16) for m in re.findall(r"Trace .*\[\w+/(\w+)/", log.read_text())]
    most, spent, inside = 0, 0, False
    for pc, then in zip(order, [*order[1:], 0], strict=True):
        inside = (inside or pc == entries["corrected"]) and pc != entries["returned"]
        if inside:
            spent += _cost(*known[pc], taken=not 0 < then - pc <= 4)
        else:
            most, spent = max(most, spent), 0
    return most


def _cost(name: str, operands: str, taken: bool) -> int:
    name = name.partition(".")[0]
    if name == "bl":
        return CYCLES["bl"]
    if name.startswith("b") and not name.startswith("bic"):
        return CYCLES["b"] if taken else 1
    if "{" in operands:  # a pop of the counter is a branch, too
        registers = operands.count(",") + (not name.endswith(("ia", "db")))
        return 1 + registers + (CYCLES["b"] if "pc" in operands else 0)
    return CYCLES.get(name[:2], 1)
