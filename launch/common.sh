# shellcheck shell=bash
# Sourced by run and test: finds Rust, a C compiler, an MPI and libclang, installs what is missing,
# and sets up the environment for cargo and mpirun. Knows nothing of scenes or tests.
# Everything it says goes to standard error: standard output may carry a picture.

repo=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
venv=$repo/.mpi

say() { printf '%s\n' "$*" >&2; }
die() { say "${0##*/}: $*"; exit 1; }
have() { command -v "$1" >/dev/null 2>&1; }

need_rust() {
    local floor found
    floor=$(sed -n 's/^rust-version *= *"\(.*\)"/\1/p' "$repo/Cargo.toml")
    # rustup's folder is not yet on the PATH of the shell that has just run rustup.
    have cargo || PATH=$PATH:$HOME/.cargo/bin
    found=$(rustc --version 2>/dev/null </dev/null | sed -n 's/^rustc \([0-9.]*\).*/\1/p') || true
    have cargo || found=
    if [[ -z $found || $(printf '%s\n' "$floor" "$found" | sort -V | head -n 1) != "$floor" ]]; then
        die "heliostat needs Rust $floor or newer, this machine has ${found:-none}. Get it with rustup:
    rustup update stable                                              # where rustup is there already
    curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh    # else; see https://rustup.rs"
    fi
}

# The MPI in use: MPICC and MPIRUN if the user names them, else what is on the PATH.
have_mpi() {
    local mpirun
    for mpirun in ${MPIRUN:-mpirun mpiexec}; do
        if have "${MPICC:-mpicc}" && have "$mpirun"; then
            export MPICC=${MPICC:-mpicc} MPIRUN=$mpirun
            return
        fi
    done
    return 1
}

# Looks where the crate clang-sys will look.
have_libclang() {
    [[ -n ${LIBCLANG_PATH:-} ]] && return
    local folders=() folder library
    IFS=: read -ra folders <<<"${LD_LIBRARY_PATH:-}"
    have llvm-config && folders+=("$(llvm-config --libdir)")
    for folder in "${folders[@]}" /usr/{,local/}lib*/{,*/,*/*/}; do
        for library in "$folder"/libclang{,-[0-9]*}.so*; do
            [[ -e $library ]] && return
        done
    done
    return 1
}

use_venv() {
    have_mpi || {
        [[ -x $venv/bin/mpicc && -x $venv/bin/mpirun ]] || return
        # Absolute paths: cargo runs the compiler wrapper in folders of its own.
        export PATH=$venv/bin:$PATH LD_LIBRARY_PATH=$venv/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
        have_mpi
    }
    have_libclang || {
        local library
        library=$(compgen -G "$venv/lib/python3*/site-packages/clang/native/libclang.so") || return
        export LIBCLANG_PATH=${library%/*}
    }
}

complete() { have cc && have_mpi && have_libclang; }

apt_packages() {
    have cc || echo gcc libc6-dev
    have_mpi || echo libopenmpi-dev openmpi-bin
    have_libclang || {
        local version
        version=$(apt-cache depends libclang-dev 2>/dev/null | sed -n 's/.*Depends: libclang-\([0-9]*\)-dev$/\1/p')
        # The library and its headers alone: the -dev packages bring ten times as much.
        if [[ -n $version ]]; then echo "libclang1-$version libclang-common-$version-dev"; else echo libclang-dev; fi
    }
}

apt_install() {
    local packages output
    read -rd '' -a packages < <(apt_packages) || true
    say "installing by apt-get: ${packages[*]}"
    output=$(DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "${packages[@]}" 2>&1 </dev/null) || {
        say "$output"
        return 1
    }
}

# A source of packages that can't be reached doesn't matter by itself.
apt_update() {
    say "updating apt's package lists"
    apt-get update -qq </dev/null >&2 || true
}

install_by_apt() {
    # Lists may be absent, or so old that the packages they name are gone.
    apt-cache show libopenmpi-dev libclang-dev >/dev/null 2>&1 || apt_update
    apt_install || { apt_update && apt_install; }
}

install_by_pip() {
    local wheels=()
    have cc && have python3 || return
    have_mpi || wheels+=(mpich)
    have_libclang || wheels+=(libclang)
    say "installing Python wheels into $venv: ${wheels[*]}"
    { python3 -m venv "$venv" && "$venv/bin/pip" install --quiet "${wheels[@]}"; } </dev/null >&2
}

# Leaves MPICC, MPIRUN and what bindgen needs in the environment.
need_mpi() {
    complete || use_venv || {
        { [[ $(id -u) == 0 ]] && have apt-get && install_by_apt; } || install_by_pip || true
        hash -r
        complete || use_venv || true
    }
    complete || die "missing:$(missing). One of these mends it:
    apt-get install gcc libc6-dev openmpi-bin libopenmpi-dev libclang-dev   # Debian, Ubuntu; done by itself if you run this as root
    apt-get install gcc libc6-dev python3-venv                              # the rest then comes from PyPI by itself, without root
    module load openmpi                                                     # on a cluster: its own MPI, whatever its module's name is
An MPI elsewhere: MPICC=/path/to/mpicc MPIRUN=/path/to/mpirun. libclang elsewhere: LIBCLANG_PATH=/its/folder."
    # Without the headers of its own that libclang wants, the C compiler's serve.
    BINDGEN_EXTRA_CLANG_ARGS="${BINDGEN_EXTRA_CLANG_ARGS:-} -idirafter $(cc -print-file-name=include)"
    export BINDGEN_EXTRA_CLANG_ARGS
    describe_mpi
}

missing() {
    have cc || printf ' %s' 'cc (a C compiler)'
    have "${MPICC:-mpicc}" || printf ' %s' "${MPICC:-mpicc}"
    have_mpi || have "${MPIRUN:-mpirun}" || printf ' %s' "${MPIRUN:-mpirun}"
    have_libclang || printf ' %s' libclang
}

# Tells the launchers apart, and sets what depends on it: `launcher`, the command up to -n; `quiet`, what
# makes it leave the talking to heliostat; CARGO_TARGET_DIR, one per MPI because the build script of mpi-sys doesn't notice a change of MPI.
# shellcheck disable=SC2034
describe_mpi() {
    local version wrapper name
    quiet=()
    version=$("$MPIRUN" --version 2>&1 </dev/null) || die "'$MPIRUN --version' fails: $version"
    wrapper=$("$MPICC" -show 2>&1) || die "'$MPICC -show' fails: $wrapper"
    case $version in
        *"Open MPI"* | *OpenRTE* | *PRRTE*)
            name=openmpi
            # Ranks bring threads of their own, so no rank may be bound to one core.
            launcher=("$MPIRUN" --bind-to none --oversubscribe)
            # Else it adds a page to each error, and may give the other ranks a second to end by themselves.
            quiet=(-q --mca odls_base_sigkill_timeout 0)
            [[ $(id -u) != 0 ]] || export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
            ;;
        *HYDRA*)
            name=mpich
            launcher=("$MPIRUN" -bind-to none)
            ;;
        *)
            # Intel's among others: no flag that all of them know.
            name=mpi
            launcher=("$MPIRUN")
            export I_MPI_PIN=off
            ;;
    esac
    name+=-$(printf '%s\n' "$MPICC" "$version" "$wrapper" | cksum | cut -d ' ' -f 1)
    export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$repo/target}/$name
    mkdir -p "$CARGO_TARGET_DIR"
    CARGO_TARGET_DIR=$(cd "$CARGO_TARGET_DIR" && pwd -P)
}
