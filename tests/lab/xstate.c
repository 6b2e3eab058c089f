/* A ptrace() for User Mode Linux on a host whose processor state is larger than it knows.

   The host's kernel refuses PTRACE_SETREGSET of NT_X86_XSTATE with any length but its own. This
   one, preloaded, sets the tracee's whole state with the caller's bytes over its beginning. They
   hold the XSAVE header: a part that it says is in its initial state is so afterwards. Those that
   the caller does not know (AMX) always are: no process of the guest can ask the host for them.
   All other requests pass through. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

static long (*next)(enum __ptrace_request, ...);
static unsigned char whole[1 << 16]; /* not on the stack: those of the guest's kernel are small */

__attribute__((constructor)) static void find_next(void) { next = dlsym(RTLD_NEXT, "ptrace"); }

long ptrace(enum __ptrace_request request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    pid_t pid = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);

    if (request == PTRACE_SETREGSET && address == (void *)NT_X86_XSTATE) {
        struct iovec *part = data, state = {whole, sizeof whole};
        int before = errno;
        if (next(PTRACE_GETREGSET, pid, address, &state) == 0 && part->iov_len < state.iov_len) {
            memcpy(whole, part->iov_base, part->iov_len);
            return next(request, pid, address, &state);
        }
        errno = before;
    }
    return next(request, pid, address, data);
}
