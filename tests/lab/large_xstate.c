/* A host kernel with 16,384 bytes of extended processor state, simulated for test_xstate.py.

   Preloaded, it answers ptrace() as such a kernel does: PTRACE_GETREGSET of NT_X86_XSTATE gives as
   much of the state as asked for, PTRACE_SETREGSET of another length than the whole is EFAULT. What
   lies beyond every real part belongs to the tracee alone: other bytes there are EFAULT, too.
   LARGE_XSTATE_IN names the only program that meets it; any other one meets a kernel that takes any
   length, also where the real one does not. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

enum { LENGTH = 16384, BEYOND = 12288 };
static long (*next)(enum __ptrace_request, ...);
static int here = 1;
static unsigned char state[LENGTH];

__attribute__((constructor)) static void start(void)
{
    const char *program = getenv("LARGE_XSTATE_IN");
    here = !program || !strcmp(program, program_invocation_short_name);
    next = dlsym(RTLD_NEXT, "ptrace");
}

static unsigned char beyond(pid_t pid, int at) { return pid * 31 + at; }

static int refused(void) { errno = EFAULT; return -1; }

static long get(pid_t pid, struct iovec *to)
{
    struct iovec real = {state, BEYOND};
    memset(state, 0, BEYOND);
    if (next(PTRACE_GETREGSET, pid, NT_X86_XSTATE, &real))
        return -1;
    for (int at = BEYOND; at < LENGTH; at++)
        state[at] = beyond(pid, at);
    if (to->iov_len > LENGTH)
        to->iov_len = LENGTH;
    memcpy(to->iov_base, state, to->iov_len);
    return 0;
}

static long set(pid_t pid, struct iovec *from)
{
    struct iovec real = {from->iov_base, BEYOND}; /* the kernel takes as much as it keeps */
    const unsigned char *bytes = from->iov_base;
    if (from->iov_len > LENGTH)
        from->iov_len = LENGTH;
    if (from->iov_len != LENGTH)
        return refused();
    for (int at = BEYOND; at < LENGTH; at++)
        if (bytes[at] != beyond(pid, at))
            return refused();
    return next(PTRACE_SETREGSET, pid, NT_X86_XSTATE, &real);
}

long ptrace(enum __ptrace_request request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    pid_t pid = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);

    if (address == (void *)NT_X86_XSTATE) {
        if (request == PTRACE_GETREGSET && here)
            return get(pid, data);
        if (request == PTRACE_SETREGSET)
            return here ? set(pid, data) : 0;
    }
    return next(request, pid, address, data);
}
